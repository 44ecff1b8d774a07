"""The functions of the command line, one for each command. None imports torch before it has read its options."""
