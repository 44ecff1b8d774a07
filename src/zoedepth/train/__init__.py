"""The two stages of training: relative depth (``relative.py``), then metric depth (``metric.py``)."""
