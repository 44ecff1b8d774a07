"""The surface of a photo as a USDZ, which iPhones and iPads show in the room around: at its true size, the photo on it.

The scene is text (USDA), which is put together here and not by usd-core, for every USD reader takes text, and the
library would be the largest dependency after torch. Tests read the files with it.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from zipfile import LargeZipFile, ZipFile, ZipInfo

import numpy as np

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.mesh import Mesh
from zoedepth.images import OWN_MARK, ImageArray, atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written
from zoedepth.outputs.surface import Y_UP, check_surface, surface_of, texture_of, unit_normals, written_surface

_SCENE, _TEXTURE = "photo.usda", "photo.jpg"
_ALIGNED = 64  # bytes of which the place of every file is a multiple
_PADDING = 0x1986  # the number by which USD's own writer marks what it fills up with
_LOCAL_HEADER = struct.calcsize("<4s5H3L2H")  # of a zip, before a file's name
_DIGITS = 6  # after the point: micrometres, and less than a hundredth of a pixel of the texture
_ROWS = 100_000  # of an array that become text at the same time
_FOCAL = 0.5  # tenths of a metre, USD's unit for cameras: 50 mm. Its other numbers are in proportion


def write_usdz(path: str | Path, mesh: Mesh, *, image: ImageArray | None = None) -> None:
    """Write a mesh as a USDZ: metres, x to the right, y up, the photo looking along -z.

    Points are those of ``write_glb``, around the camera of the photo. The prim that holds them all stands with the
    middle of its foot at the origin, which is where Quick Look puts it on a floor or a table. The photo shines in its
    own light (an emissive ``UsdPreviewSurface``), as a photo already has the light of its scene. The camera is in the
    file, too; a panorama has none.

    Args:
        path: where to write; missing folders are made.
        mesh: triangles in OpenCV's axes.
        image: the photo, RGB, of any size: the texture; reduced to ``surface.MAX_TEXTURE`` pixels where it is larger.
            Without it the mesh has normals in its place.

    Raises:
        InputError: the mesh has no triangle, or takes 2 GiB and more.

    Source: the specifications of usdz and of UsdPreviewSurface at openusd.org.
    """
    check_surface(mesh)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        try:
            with ZipFile(file, "w", allowZip64=False) as archive:
                with archive.open(_aligned(_SCENE, file.tell()), "w") as entry:
                    for text in _scene(mesh, textured=image is not None):
                        entry.write(text.encode("ascii"))
                if image is not None:
                    archive.writestr(_aligned(_TEXTURE, file.tell()), texture_of(image))
        except (LargeZipFile, RuntimeError) as error:  # as zipfile says of one file that it is too large
            raise InputError("a USDZ has less than 2 GiB, and this mesh takes more: give --max-triangles") from error


def _aligned(name: str, place: int) -> ZipInfo:
    """Return the entry of a file that is stored as it is, and begins where the format wants it.

    Args:
        name: its name, in ASCII.
        place: bytes before it in the archive.
    """
    entry = ZipInfo(name)  # of 1980, for the same depth is always the same file
    n_padding = -(place + _LOCAL_HEADER + len(name) + 4) % _ALIGNED
    entry.extra = struct.pack("<HH", _PADDING, n_padding) + bytes(n_padding)
    return entry


def _scene(mesh: Mesh, *, textured: bool) -> Iterator[str]:
    """Yield the scene in USD's words, piece by piece."""
    points = mesh.vertices * Y_UP
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    (left, bottom, back), (right, _, front) = extent.astype(np.float64).round(_DIGITS).tolist()
    yield f"""#usda 1.0
(
    customLayerData = {{
        string creator = "{OWN_MARK}"
    }}
    defaultPrim = "photo"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "photo" (
    kind = "component"
)
{{
    double3 xformOp:translate = ({-(left + right) / 2:.7f}, {-bottom:.6f}, {-(back + front) / 2:.7f})
    uniform token[] xformOpOrder = ["xformOp:translate"]

    def Mesh "surface"{' (prepend apiSchemas = ["MaterialBindingAPI"])' if textured else ""}
    {{
        uniform token subdivisionScheme = "none"
        uniform bool doubleSided = true
        float3[] extent = """
    yield from _array(extent)
    yield "\n        int[] faceVertexCounts = "
    yield from _array(np.full(len(mesh.faces), 3))
    yield "\n        int[] faceVertexIndices = "
    yield from _array(mesh.faces.reshape(-1))
    yield "\n        point3f[] points = "
    yield from _array(points)
    if textured:
        yield "\n        texCoord2f[] primvars:st = "
        yield from _array(mesh.uv * (1, -1) + (0, 1))  # from the bottom left corner
        yield ' (interpolation = "vertex")\n        rel material:binding = </photo/material>\n    }\n'
        yield _material(wrap="repeat" if mesh.camera is None else "clamp")
    else:
        yield "\n        normal3f[] normals = "
        yield from _array(unit_normals(mesh) * Y_UP)
        yield ' (interpolation = "vertex")\n    }\n'
    if mesh.camera is not None:
        yield _camera(mesh.camera)
    yield "}\n"


def _array(values: np.ndarray) -> Iterator[str]:
    """Yield an array as USD writes it, which is as Python shows lists: of numbers, or of tuples for vectors."""
    yield "["
    for start in range(0, len(values), _ROWS):
        rows = values[start : start + _ROWS]
        shown = rows.tolist() if rows.ndim == 1 else [*map(tuple, rows.astype(np.float64).round(_DIGITS).tolist())]
        yield (", " if start else "") + str(shown)[1:-1]
    yield "]"


def _material(*, wrap: str) -> str:
    """Return a material that shows the texture in its own light, and reflects none.

    Args:
        wrap: continuation of the texture beyond its left and right border, in USD's words.
    """
    return f"""
    def Material "material"
    {{
        token outputs:surface.connect = </photo/material/surface.outputs:surface>

        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0, 0, 0)
            color3f inputs:emissiveColor.connect = </photo/material/texture.outputs:rgb>
            float inputs:ior = 1
            float inputs:metallic = 0
            float inputs:roughness = 1
            token outputs:surface
        }}

        def Shader "texture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{_TEXTURE}@
            token inputs:sourceColorSpace = "sRGB"
            float2 inputs:st.connect = </photo/material/place.outputs:result>
            token inputs:wrapS = "{wrap}"
            token inputs:wrapT = "clamp"
            float3 outputs:rgb
        }}

        def Shader "place"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
    }}
"""


def _camera(camera: Camera) -> str:
    """Return the camera of the photo, which need not look through the middle of it."""
    height, width = camera.size
    across, along = _FOCAL / camera.fx, _FOCAL / camera.fy  # of a pixel
    return f"""
    def Camera "camera"
    {{
        float2 clippingRange = (0.01, 10000)
        float focalLength = {_FOCAL}
        float horizontalAperture = {width * across:.9g}
        float horizontalApertureOffset = {((width - 1) / 2 - camera.cx) * across:.9g}
        token projection = "perspective"
        float verticalAperture = {height * along:.9g}
        float verticalApertureOffset = {(camera.cy - (height - 1) / 2) * along:.9g}
        custom string source = "{camera.source}"
    }}
"""


def _write(path: Path, maps: Maps, options: Options) -> Written:
    mesh = surface_of(maps, options.max_triangles)
    write_usdz(path, mesh, image=maps.image)
    return written_surface(mesh, maps)


USDZ = Output(".usdz", "the surface with the photo on it, for AR on iPhones", _write, suffixes=(".usdz",))
