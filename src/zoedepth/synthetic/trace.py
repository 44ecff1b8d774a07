"""Rays into a scene's triangles, by Intel's Embree."""

import os
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from zoedepth.errors import MissingExtraError
from zoedepth.synthetic.scene import Arrays

Vectors = Float32[np.ndarray, "n 3"]


class Hits(NamedTuple):
    """Where rays first meet a surface."""

    distance: Float32[np.ndarray, " n"]
    """In lengths of the ray's direction; infinite for a miss."""
    triangle: Int32[np.ndarray, " n"]
    """-1 for a miss."""
    face: Float32[np.ndarray, "n 3"]
    """The triangle's normal, of any length, on either side."""
    first: Float32[np.ndarray, " n"]
    second: Float32[np.ndarray, " n"]
    """Weights of the triangle's second and third corner."""

    def take(self, rows: np.ndarray) -> "Hits":
        """Those of some rays."""
        return Hits(*(column.take(rows, 0) for column in self))


class Tracer:
    """A scene's triangles, ready for rays.

    Raises:
        MissingExtraError: embreex is not installed.
    """

    def __init__(self, arrays: Arrays) -> None:
        meshes, scenes, device = _embree(os.getpid())
        self._scene = scenes.EmbreeScene(device, robust=True)
        self._mesh = meshes.TriangleMesh(self._scene, arrays.vertices, arrays.triangles)

    def hits(self, origins: Vectors, directions: Vectors) -> Hits:
        """The first surface along each ray."""
        found = self._scene.run(_rows(origins, len(directions)), np.ascontiguousarray(directions), output=1)
        triangle = found["primID"]
        return Hits(
            np.where(triangle < 0, np.float32(np.inf), found["tfar"]), triangle, found["Ng"], found["u"], found["v"]
        )

    def blocked(self, origins: Vectors, directions: Vectors, far: Float32[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Whether anything is met before ``far``, in lengths of the direction."""
        if not len(directions):
            return np.zeros(0, bool)
        # Embree overwrites the distances it is given.
        found = self._scene.run(
            _rows(origins, len(directions)), np.ascontiguousarray(directions), far.copy(), "OCCLUDED"
        )
        return found >= 0


def _rows(origins: Vectors, count: int) -> Vectors:
    return np.ascontiguousarray(np.broadcast_to(origins, (count, 3)))


@cache
def _embree(process: int) -> tuple[Any, Any, Any]:
    """(mesh module, scene module, device). Each process has its own device: a forked one cannot use its parent's."""
    try:
        from embreex import mesh_construction, rtcore_scene
        from embreex.rtcore import EmbreeDevice
    except ImportError as error:
        raise MissingExtraError("synthetic", "rendering synthetic scenes") from error
    return mesh_construction, rtcore_scene, EmbreeDevice()
