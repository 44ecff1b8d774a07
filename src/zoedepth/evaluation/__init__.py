"""Evaluation: protocols as data, sources of predictions, and the function that scores every source on every set.

``evaluate.evaluate`` is where to begin; docs/evaluation.md shows how to call it.
"""
