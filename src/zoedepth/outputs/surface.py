"""The surface of a photo and the photo on it, as the files of meshes have them."""

from io import BytesIO

import numpy as np
from jaxtyping import Float32
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.geometry.mesh import Mesh, build_mesh
from zoedepth.geometry.panorama import build_panorama_mesh
from zoedepth.images import ImageArray
from zoedepth.outputs.output import Maps, Written, needed

MAX_TEXTURE = 4096
"""The longest side of the photo on a mesh, in pixels: what phones and browsers can show."""

Y_UP = np.array([1, -1, -1], np.float32)
"""Half a turn about x: from OpenCV's axes (y down, z forward) to those of glTF and USD (y up, z backward)."""

_REDUCED = f"the photo on the mesh has {MAX_TEXTURE} pixels on its longer side, as many as all browsers show"
_QUALITY = 90


def surface_of(maps: Maps, max_triangles: int | None) -> Mesh:
    """Return the triangles between the valid pixels, at most so many; None keeps all.

    Raises:
        InputError: there is no depth or no camera.
        MissingExtraError: there are more, and fast-simplification is not installed.
    """
    depth = needed(maps, "depth")
    if maps.panorama:
        return build_panorama_mesh(depth, valid=maps.valid, max_triangles=max_triangles)
    return build_mesh(depth, needed(maps, "camera"), valid=maps.valid, max_triangles=max_triangles)


def check_surface(mesh: Mesh) -> None:
    """Refuse a mesh of which there is nothing to show.

    Raises:
        InputError: it has no triangle.
    """
    if not len(mesh.faces):
        raise InputError("the depth makes no surface, for no two neighbouring pixels see the same one: save its points")


def unit_normals(mesh: Mesh) -> Float32[np.ndarray, "vertices 3"]:
    """Return the normals, which all have length 1; where a triangle has no area, towards the camera."""
    length = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
    away = np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return np.where(length > 0.5, mesh.normals / np.maximum(length, 0.5), -mesh.vertices / away)


def texture_of(image: ImageArray) -> bytes:
    """Return the photo as a JPEG of at most ``MAX_TEXTURE`` pixels on its longer side."""
    picture = Image.fromarray(image)
    picture.thumbnail((MAX_TEXTURE, MAX_TEXTURE), Image.Resampling.LANCZOS)
    file = BytesIO()
    picture.save(file, format="JPEG", quality=_QUALITY)
    return file.getvalue()


def written_surface(mesh: Mesh, maps: Maps) -> Written:
    """Return what is worth saying about the file of a surface."""
    reduced = maps.image is not None and max(maps.image.shape) > MAX_TEXTURE
    return Written({"triangles": len(mesh.faces)}, (_REDUCED,) if reduced else ())
