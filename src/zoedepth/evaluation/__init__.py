"""Evaluation: protocols as data, and the function that scores a model under one."""
