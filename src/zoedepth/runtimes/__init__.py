"""The runtimes that can compute a model here: measured, the fastest written down, and taken.

``benchmark`` measures all that are installed, a row each, in processes of their own (``worker``); ``choice`` keeps the
fastest that is close enough to torch in float32. ``fast`` loads a model for it, or decides by less where nothing was
measured. Exported files are kept in the user's cache (``exports``).
"""
