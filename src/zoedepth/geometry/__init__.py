"""Cameras and what they see. Nothing here knows of a model."""
