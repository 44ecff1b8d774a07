"""What the command line calls: one function a command. None imports torch before it has read its options."""
