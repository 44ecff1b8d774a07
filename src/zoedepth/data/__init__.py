"""Data sets, augmentation and mixing: files to batches for training and evaluation."""
