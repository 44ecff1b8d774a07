"""A mesh of what a camera sees: triangles between neighbouring pixels of one surface."""

import math
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.jumps import flying_pixels, jumps
from zoedepth.geometry.normals import estimate_normals
from zoedepth.geometry.points import check_size, known_depth, unproject

_SIMPLIFYING = Lock()  # fast-simplification keeps the mesh that it works on in one place for the whole process
_FEWEST = 32  # pixels of the shorter side that are kept, however few triangles are asked for


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in space, and the place of their corners in the photo."""

    vertices: Float32[np.ndarray, "vertices 3"]
    """Metres, in OpenCV's axes: x to the right, y down, z forward."""
    faces: Int32[np.ndarray, "faces 3"]
    """Rows in ``vertices``, counterclockwise for whoever looks from the camera."""
    uv: Float32[np.ndarray, "vertices 2"]
    """Place in the photo: from (0, 0), the top left corner, to (1, 1), the bottom right one, as glTF has it."""
    normals: Float32[np.ndarray, "vertices 3"]
    """Unit vectors towards the side from which the camera sees the surface."""
    camera: Camera | None
    """The camera that sees it so; None for a panorama."""


def build_mesh(
    depth: Float[np.ndarray, "height width"],
    camera: Camera,
    *,
    valid: Bool[np.ndarray, "height width"] | None = None,
    max_triangles: int | None = None,
) -> Mesh:
    """Join neighbouring pixels to triangles, but not across jumps of depth.

    Args:
        depth: metres along the optical axis; a pixel without a finite number above 0 is left out.
        camera: the camera at the size of the depth map.
        valid: pixels to take; None takes all that are no flying pixels.
        max_triangles: fewer triangles than one or two for each pixel: see ``simplify``. A depth map of more pixels is
            taken at every second one, third one, and so on, first. None keeps all.

    Raises:
        InputError: the camera or ``valid`` is of another size, or ``max_triangles`` is below 1.
        MissingExtraError: ``max_triangles`` is given, and fast-simplification is not installed.
    """
    check_size(depth, camera)
    if valid is None:
        valid = ~flying_pixels(depth, camera)
    if valid.shape != depth.shape:
        raise InputError(f"valid has shape {valid.shape} and the depth {depth.shape}: give them the same size")
    step = grid_step(depth.shape, max_triangles)
    top, left = ((side - 1) % step // 2 for side in depth.shape)
    depth, valid = depth[top::step, left::step], valid[top::step, left::step]
    # The camera that sees no other pixels than those.
    seen = replace(
        camera,
        size=depth.shape,
        fx=camera.fx / step,
        fy=camera.fy / step,
        cx=(camera.cx - left) / step,
        cy=(camera.cy - top) / step,
    )
    taken = valid & known_depth(depth)
    faces = join(depth, taken, *jumps(np.where(taken, depth, np.nan), seen))
    used = np.zeros(depth.size, bool)
    used[faces] = True
    places = np.flatnonzero(used)
    number = np.zeros(depth.size, np.int32)
    number[places] = np.arange(len(places), dtype=np.int32)
    row, column = top + step * (places // depth.shape[1]), left + step * (places % depth.shape[1])
    height, width = camera.size
    mesh = Mesh(
        vertices=unproject(depth, seen).reshape(-1, 3)[places],
        faces=number[faces],
        uv=np.stack([(column + 0.5) / width, (row + 0.5) / height], axis=1).astype(np.float32),
        normals=estimate_normals(np.where(taken, depth, np.nan), seen).reshape(-1, 3)[places],
        camera=camera,
    )
    return mesh if max_triangles is None else simplify(mesh, max_triangles)


def simplify(mesh: Mesh, max_triangles: int) -> Mesh:
    """Return a mesh of the same shape with at most ``max_triangles`` triangles, fewer where the surface is flat.

    Raises:
        InputError: ``max_triangles`` is below 1, or the mesh is that of a panorama: give ``max_triangles`` when it is
            built.
        MissingExtraError: fast-simplification is not installed.
    """
    if mesh.camera is None:
        raise InputError("the mesh of a panorama is not simplified later: give max_triangles when you build it")
    vertices, faces = reduce_triangles(mesh.vertices, mesh.faces, max_triangles)
    if faces is mesh.faces:
        return mesh
    place = mesh.camera.project(vertices.astype(np.float64)) + 0.5
    uv = (place / (mesh.camera.size[1], mesh.camera.size[0])).astype(np.float32)
    return Mesh(vertices, faces, uv, vertex_normals(vertices, faces), mesh.camera)


def reduce_triangles(
    vertices: Float32[np.ndarray, "vertices 3"], faces: Int32[np.ndarray, "faces 3"], max_triangles: int
) -> tuple[Float32[np.ndarray, "fewer 3"], Int32[np.ndarray, "fewer_faces 3"]]:
    """Return vertices and faces of the same shape with at most ``max_triangles`` faces; the same ones if they are few.

    Raises:
        InputError: ``max_triangles`` is below 1.
        MissingExtraError: fast-simplification is not installed.
    """
    check_triangles(max_triangles)
    if len(faces) <= max_triangles:
        return vertices, faces
    try:
        import fast_simplification
    except ImportError as error:
        raise MissingExtraError("mesh", "simplifying a mesh") from error
    with _SIMPLIFYING:
        result = fast_simplification.simplify(vertices, faces, target_count=max_triangles)
    return result[0].astype(np.float32), result[1].astype(np.int32)


def vertex_normals(
    vertices: Float32[np.ndarray, "vertices 3"], faces: Int32[np.ndarray, "faces 3"]
) -> Float32[np.ndarray, "vertices 3"]:
    """Return the mean normal of the triangles around each vertex, weighted by their area; unit vectors."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.cross(b - a, c - a).astype(np.float64)
    total = np.stack([
        sum(np.bincount(faces[:, corner], area[:, axis], len(vertices)) for corner in range(3)) for axis in range(3)
    ], axis=1)  # fmt: skip
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return (total / np.where(length > 0, length, 1)).astype(np.float32)


def check_triangles(max_triangles: int) -> None:
    """Refuse a number of triangles that no mesh can have.

    Raises:
        InputError: it is below 1.
    """
    if max_triangles < 1:
        raise InputError(f"a mesh has at least 1 triangle, got max_triangles={max_triangles}")


def grid_step(size: tuple[int, ...], max_triangles: int | None) -> int:
    """Return how many pixels apart those are that a mesh of at most ``max_triangles`` is made of.

    A grid has two triangles for each pixel. At most four times as many as are wanted are made, for ``simplify`` to
    leave those out where the surface is flat; that takes a second or two for each million.

    Raises:
        InputError: ``max_triangles`` is below 1.
    """
    if max_triangles is None:
        return 1
    check_triangles(max_triangles)
    return min(math.ceil(math.sqrt(size[0] * size[1] / max_triangles / 2)), max(1, min(size) // _FEWEST))


def join(
    depth: Float[np.ndarray, "height width"],
    taken: Bool[np.ndarray, "height width"],
    across: Bool[np.ndarray, "height gaps_across"],
    along: Bool[np.ndarray, "gaps_along width"],
) -> Int32[np.ndarray, "faces 3"]:
    """Return the triangles between neighbouring pixels: of each square of four the two, the one, or none.

    Args:
        depth: metres; the diagonal of a square goes between the two corners that are nearer to each other.
        taken: pixels that may be corners.
        across: gaps between neighbours of a row that no triangle bridges, as ``jumps`` returns them.
        along: gaps between neighbours of a column.

    Returns:
        Numbers of pixels, counted row by row, counterclockwise as the camera sees them.
    """
    height, width = depth.shape
    top, bottom, left, right = ~across[:-1], ~across[1:], ~along[:, :-1], ~along[:, 1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = 1 / depth
        falls = np.abs(inverse[:-1, :-1] - inverse[1:, 1:]) <= np.abs(inverse[:-1, 1:] - inverse[1:, :-1])
    # A square with a corner missing has only one diagonal.
    falls = np.where(taken[:-1, :-1] & taken[1:, 1:], falls | ~(taken[:-1, 1:] & taken[1:, :-1]), False)
    number = np.arange(height * width, dtype=np.int32).reshape(height, width)
    nw, ne, sw, se = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    kinds = (
        (falls & left & bottom, (nw, sw, se)),
        (falls & top & right, (nw, se, ne)),
        (~falls & top & left, (nw, sw, ne)),
        (~falls & right & bottom, (ne, sw, se)),
    )
    return np.concatenate([np.stack([corner[kind] for corner in corners], axis=1) for kind, corners in kinds])
