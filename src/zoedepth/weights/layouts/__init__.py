"""Other people's checkpoints: a table of names for each layout, and configs told by shapes and files."""
