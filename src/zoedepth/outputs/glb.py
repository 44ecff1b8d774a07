"""The surface of a photo as a GLB: a mesh at its true size, with the photo on it.

The file is put together here and not by trimesh, which stores a photo as PNG (five times as large) or as JPEG at
quality 75, and has no material that shows a photo in its own light.
"""

import json
import math
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.mesh import Mesh
from zoedepth.images import OWN_MARK, ImageArray, atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written
from zoedepth.outputs.surface import Y_UP, check_surface, surface_of, texture_of, unit_normals, written_surface

# Numbers of the standard (glTF 2.0): types of numbers, kinds of buffers, filters and edges of textures.
_UINT32, _FLOAT32, _VERTICES, _INDICES = 5125, 5126, 34962, 34963
_LINEAR, _LINEAR_MIPMAP, _REPEAT, _CLAMP = 9729, 9987, 10497, 33071


def write_glb(path: str | Path, mesh: Mesh, *, image: ImageArray | None = None) -> None:
    """Write a mesh as a binary glTF 2.0: metres, x to the right, y up, the camera at the origin, looking along -z.

    The photo is a texture that shows in its own light (KHR_materials_unlit), with normals for programs that light it
    nevertheless. The camera is in the file, too, so that a program can look at the mesh as the photo does; a panorama
    has none.

    Args:
        path: where to write; missing folders are made.
        mesh: triangles in OpenCV's axes.
        image: the photo, RGB, of any size: the texture; reduced to ``surface.MAX_TEXTURE`` pixels where it is larger.

    Raises:
        InputError: the mesh has no triangle, or takes 4 GiB and more.
    """
    check_surface(mesh)
    arrays = {
        "indices": mesh.faces.astype("<u4").reshape(-1),
        "POSITION": (mesh.vertices * Y_UP).astype("<f4"),
        "NORMAL": (unit_normals(mesh) * Y_UP).astype("<f4"),
        "TEXCOORD_0": mesh.uv.astype("<f4"),
    }
    document: dict[str, Any] = {
        "asset": {"generator": OWN_MARK, "version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "surface", "mesh": 0}],
        "meshes": [{"name": "surface", "primitives": [_primitive(list(arrays))]}],
        "materials": [_material(textured=image is not None)],
        "accessors": [_accessor(number, *named) for number, named in enumerate(arrays.items())],
    }
    if mesh.camera is not None:
        document["asset"]["extras"] = _about(mesh.camera)
        document["scenes"][0]["nodes"].append(1)
        document["nodes"].append({"name": "camera of the photo", "camera": 0})
        document["cameras"] = [_camera(mesh.camera)]
    parts = [np.ascontiguousarray(values).tobytes() for values in arrays.values()]
    if image is not None:
        around = _REPEAT if mesh.camera is None else _CLAMP
        document |= {
            "extensionsUsed": ["KHR_materials_unlit"],
            "images": [{"bufferView": len(parts), "mimeType": "image/jpeg"}],
            "samplers": [{"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP, "wrapS": around, "wrapT": _CLAMP}],
            "textures": [{"source": 0, "sampler": 0}],
        }
        parts.append(texture_of(image))
    _write_container(path, document, parts, targets=[_INDICES, _VERTICES, _VERTICES, _VERTICES])


def _write_container(path: str | Path, document: dict[str, Any], parts: list[bytes], *, targets: list[int]) -> None:
    """Write the JSON and the binary part of a GLB.

    Args:
        path: where to write.
        document: the JSON without the places of the parts, which are added.
        parts: bytes of its bufferViews, in their order.
        targets: uses of the first of them, as glTF numbers uses.

    Raises:
        InputError: they are too large for the format.
    """
    views, place = [], 0
    for part, target in zip_longest(parts, targets):
        view = {"buffer": 0, "byteOffset": place, "byteLength": len(part)}
        views.append(view if target is None else {**view, "target": target})
        place += _padded(len(part))
    document = {**document, "bufferViews": views, "buffers": [{"byteLength": place}]}
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (_padded(len(text)) - len(text))
    total = 12 + 8 + len(text) + 8 + place
    if total >= 1 << 32:
        raise InputError(f"a GLB has less than 4 GiB, and this mesh takes {total:,} bytes: give --max-triangles")
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(b"glTF" + np.array([2, total, len(text)], "<u4").tobytes() + b"JSON" + text)
        file.write(np.array([place], "<u4").tobytes() + b"BIN\0")
        for part in parts:
            file.write(part)
            file.write(bytes(_padded(len(part)) - len(part)))


def _padded(n_bytes: int) -> int:
    """Return the next multiple of 4, at which every part of the file must begin."""
    return n_bytes + -n_bytes % 4


def _primitive(names: list[str]) -> dict[str, object]:
    """Return what the triangles are made of: the arrays of these names, of which the first is the indices."""
    attributes = {name: number for number, name in enumerate(names) if number}
    return {"attributes": attributes, "indices": 0, "material": 0}


def _accessor(number: int, name: str, values: np.ndarray) -> dict[str, object]:
    """Return the type of an array: numbers of it as it is, or vectors. Places have their bounds, as glTF demands."""
    vectors = values.ndim > 1
    bounds = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if name == "POSITION" else {}
    return {
        "bufferView": number,
        "componentType": _FLOAT32 if vectors else _UINT32,
        "count": len(values),
        "type": f"VEC{values.shape[1]}" if vectors else "SCALAR",
        **bounds,
    }


def _material(*, textured: bool) -> dict[str, object]:
    surface: dict[str, object] = {"metallicFactor": 0, "roughnessFactor": 1}
    if textured:
        surface["baseColorTexture"] = {"index": 0}
    lighting = {"extensions": {"KHR_materials_unlit": {}}} if textured else {}
    return {"name": "photo", "pbrMetallicRoughness": surface, "doubleSided": True, **lighting}


def _camera(camera: Camera) -> dict[str, object]:
    """Return a camera that sees as much as the photo. In glTF it looks through the middle of the picture."""
    height, width = camera.size
    view = {
        "yfov": 2 * math.atan(height / 2 / camera.fy),
        "aspectRatio": width / camera.fx / (height / camera.fy),
        "znear": 0.01,
    }
    return {"type": "perspective", "perspective": view}


def _about(camera: Camera) -> dict[str, object]:
    """Return what glTF's camera cannot say."""
    return {"intrinsics": camera.matrix.tolist(), "size": list(camera.size), "cameraSource": camera.source}


def _write(path: Path, maps: Maps, options: Options) -> Written:
    mesh = surface_of(maps, options.max_triangles)
    write_glb(path, mesh, image=maps.image)
    return written_surface(mesh, maps)


GLB = Output(".glb", "the surface as a mesh with the photo on it", _write, suffixes=(".glb",))
