"""Rays into a scene's triangles, traced by Intel's Embree."""

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
    """Distance in lengths of the ray's direction; infinite for a miss."""
    triangle: Int32[np.ndarray, " n"]
    """Number of the triangle; -1 for a miss."""
    face: Float32[np.ndarray, "n 3"]
    """Normal of the triangle, of any length; it may point away from the viewer."""
    first: Float32[np.ndarray, " n"]
    """Weight of the triangle's second corner at the hit."""
    second: Float32[np.ndarray, " n"]
    """Weight of its third corner."""

    def take(self, rows: np.ndarray) -> "Hits":
        """Return the hits of some of the rays."""
        return Hits(*(column.take(rows, 0) for column in self))


class Tracer:
    """The triangles of a scene, ready for rays.

    Raises:
        MissingExtraError: embreex is not installed.
    """

    def __init__(self, arrays: Arrays) -> None:
        meshes, scenes, device = _embree(os.getpid())
        self._scene = scenes.EmbreeScene(device, robust=True)
        self._mesh = meshes.TriangleMesh(self._scene, arrays.vertices, arrays.triangles)

    def hits(self, origins: Vectors, directions: Vectors) -> Hits:
        """Return the first surface that each ray meets.

        Args:
            origins: one point for all rays, or one each.
            directions: vectors of any length.
        """
        found = self._scene.run(_rows(origins, len(directions)), np.ascontiguousarray(directions), output=1)
        triangle = found["primID"]
        return Hits(
            np.where(triangle < 0, np.float32(np.inf), found["tfar"]), triangle, found["Ng"], found["u"], found["v"]
        )

    def blocked(self, origins: Vectors, directions: Vectors, far: Float32[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return True where a ray meets something before ``far``, in lengths of its direction."""
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
    """Return (mesh module, scene module, device), one device a process: a forked process cannot use its parent's."""
    try:
        from embreex import mesh_construction, rtcore_scene
        from embreex.rtcore import EmbreeDevice
    except ImportError as error:
        raise MissingExtraError("synthetic", "rendering synthetic scenes") from error
    return mesh_construction, rtcore_scene, EmbreeDevice()
