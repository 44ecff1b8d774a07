"""Cameras as files of other programs keep them: OpenCV, ROS, COLMAP, NeRFs, plain matrices, and our own JSON."""

from pathlib import Path

from zoedepth.geometry.camera import Camera


def read_camera(path: str | Path, size: tuple[int, int]) -> Camera:
    """Read the camera of a photo of ``size`` (height, width) from a file."""
    raise NotImplementedError
