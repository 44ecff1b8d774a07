"""Scenes made up and rendered with exact metric depth: rooms and streets, for training without a download."""

from zoedepth.synthetic.dataset import SyntheticScenes

__all__ = ["SyntheticScenes"]
