"""Other people's checkpoints: a table of names for each layout, and the config that their shapes and files tell."""
