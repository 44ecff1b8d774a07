"""The runtimes that can compute a model here: measured, the fastest written down, and taken.

``benchmark`` measures all that are installed, a row each, in processes of their own (``worker``); ``choice`` keeps the
fastest that is close enough to torch in float32. ``fast`` loads a model for it or, without a
benchmark, by the installed runtimes and one measured product. Exported files are kept in the user's cache
(``exports``).
"""
