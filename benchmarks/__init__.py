"""Timings: ``python -m benchmarks [NAME ...]``. Alternatives are timed in turn in one run, and given as ratios."""
