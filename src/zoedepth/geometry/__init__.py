"""Cameras and what they see. Nothing here knows a model."""
