"""USDZ: its zip and its text as the specification has them, and its scene as usd-core reads it, which did not write it.

The surface is compared with that of the GLB of the same maps.
"""

import re
import struct
import sys
from ast import literal_eval
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile

import numpy as np
import pytest
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.mesh import build_mesh
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.glb import GLB
from zoedepth.outputs.usdz import USDZ, write_usdz

SIZE = (6, 8)
CAMERA = Camera(SIZE, 10.0, 11.0, 3.0, 2.0, "exif")
DEPTH = np.add.outer(np.linspace(0, 0.02, 6), np.linspace(2, 2.05, 8)).astype(np.float32)
IMAGE = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), np.uint8)
MAPS = Maps(depth=DEPTH, image=IMAGE, camera=CAMERA)
MESH = build_mesh(DEPTH, CAMERA)


def scene(path: Path) -> str:
    with ZipFile(path) as archive:
        return archive.read(archive.namelist()[0]).decode("ascii")


def array(text: str, name: str) -> np.ndarray:
    """Return an array of a scene, which Python reads, too."""
    found = re.search(rf"\[\] {name} = (\[.*?\])", text)
    assert found, name
    return np.array(literal_eval(found[1]))


def surface_of_glb(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, faces and places in the photo of the GLB of the same maps."""
    file = pytest.importorskip("pygltflib").GLTF2()
    GLB.write(path, MAPS, Options())
    file = file.load(str(path))
    arrays = []
    for view, kind in zip(file.bufferViews, ("<u4", "<f4", "<f4", "<f4"), strict=False):
        content = file.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
        arrays.append(np.frombuffer(content, kind))
    return arrays[1].reshape(-1, 3), arrays[0].reshape(-1, 3), arrays[3].reshape(-1, 2)


def test_zip_is_stored_and_aligned_and_begins_with_the_scene(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "a.usdz"
    assert USDZ.write(path, MAPS, Options()).facts == {"triangles": 70}
    content = path.read_bytes()
    with ZipFile(path) as archive:
        assert archive.testzip() is None
        entries = archive.infolist()
        assert [entry.filename for entry in entries] == ["photo.usda", "photo.jpg"]
        for entry in entries:
            # The local header, by which programs find the data: what is written there is what the list at the end says.
            head = struct.unpack_from("<4s5H3L2H", content, entry.header_offset)
            assert (head[0], head[2], head[3]) == (
                b"PK\3\4",
                0,
                ZIP_STORED,
            )  # no flags: neither a secret nor sizes behind
            assert head[6:9] == (entry.CRC, entry.file_size, entry.file_size)
            start = entry.header_offset + 30 + head[9] + head[10]
            assert start % 64 == 0
            assert content[start : start + entry.file_size] == archive.read(entry)
        with Image.open(BytesIO(archive.read("photo.jpg"))) as texture:
            assert (texture.format, texture.size) == ("JPEG", (8, 6))


def test_scene_is_in_metres_and_has_the_surface_of_the_glb(tmp_path: Path) -> None:
    USDZ.write(tmp_path / "a.usdz", MAPS, Options())
    text = scene(tmp_path / "a.usdz")
    assert text.startswith("#usda 1.0\n(")
    assert {"    metersPerUnit = 1", '    upAxis = "Y"', '    defaultPrim = "photo"'} <= set(text.splitlines())
    vertices, faces, uv = surface_of_glb(tmp_path / "a.glb")
    np.testing.assert_allclose(array(text, "points"), vertices, atol=5.1e-7)
    np.testing.assert_array_equal(array(text, "faceVertexIndices").reshape(-1, 3), faces)
    assert array(text, "faceVertexCounts").tolist() == [3] * len(faces)
    np.testing.assert_allclose(array(text, "primvars:st"), uv * (1, -1) + (0, 1), atol=5.1e-7)
    points = array(text, "points")
    np.testing.assert_array_equal(array(text, "extent"), [points.min(axis=0), points.max(axis=0)])
    moved = re.search(r"xformOp:translate = (\(.*\))", text)
    assert moved
    low, high = array(text, "extent") + literal_eval(moved[1])
    np.testing.assert_allclose((low[1], *(low + high)[[0, 2]]), 0, atol=1e-9)  # stands on the middle of its foot


def test_of_a_panorama_has_no_camera_and_a_texture_that_goes_round(tmp_path: Path) -> None:
    wraps = re.compile(r'inputs:wrap(.) = "(\w+)"')
    write_usdz(tmp_path / "a.usdz", replace(MESH, camera=None), image=IMAGE)
    assert "def Camera" not in scene(tmp_path / "a.usdz")
    assert wraps.findall(scene(tmp_path / "a.usdz")) == [("S", "repeat"), ("T", "clamp")]
    write_usdz(tmp_path / "a.usdz", MESH, image=IMAGE)
    assert "def Camera" in scene(tmp_path / "a.usdz")
    assert wraps.findall(scene(tmp_path / "a.usdz")) == [("S", "clamp"), ("T", "clamp")]


def test_without_a_photo_has_normals_and_no_texture(tmp_path: Path) -> None:
    write_usdz(tmp_path / "a.usdz", MESH)
    text = scene(tmp_path / "a.usdz")
    np.testing.assert_allclose(array(text, "normals"), MESH.normals * (1, -1, -1), atol=5.1e-7)
    assert "Material" not in text
    normals = MESH.normals.copy()
    normals[5] = 0  # triangles without an area
    write_usdz(tmp_path / "b.usdz", replace(MESH, normals=normals))
    np.testing.assert_allclose(np.linalg.norm(array(scene(tmp_path / "b.usdz"), "normals"), axis=1), 1, atol=2e-6)
    with ZipFile(tmp_path / "a.usdz") as archive:
        assert archive.namelist() == ["photo.usda"]


def test_arrays_of_many_pieces_are_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_usdz(tmp_path / "whole.usdz", MESH, image=IMAGE)
    monkeypatch.setattr("zoedepth.outputs.usdz._ROWS", 7)
    write_usdz(tmp_path / "pieces.usdz", MESH, image=IMAGE)
    assert (tmp_path / "pieces.usdz").read_bytes() == (tmp_path / "whole.usdz").read_bytes()


@pytest.mark.parametrize("limit", [2000, 4000])  # less than the scene, and than both files
def test_mesh_that_is_too_large_for_the_format_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int
) -> None:
    """A smaller limit stands for 2 GiB."""
    monkeypatch.setattr("zipfile.ZIP64_LIMIT", limit)
    with pytest.raises(InputError, match="less than 2 GiB"):
        write_usdz(tmp_path / "a.usdz", MESH, image=IMAGE)
    assert list(tmp_path.iterdir()) == []


def test_needs_a_surface(tmp_path: Path) -> None:
    pixel = Maps(depth=np.ones((1, 1), np.float32), camera=Camera.from_focal(1.0, (1, 1)))
    with pytest.raises(InputError, match="no surface"):
        USDZ.write(tmp_path / "a.usdz", pixel, Options())
    assert list(tmp_path.iterdir()) == []


# usd-core has no wheel for Python 3.10, where the structure of the file is checked above without it. From 3.11 on it is
# among the tools of development, and a test that does not find it fails.
@pytest.mark.skipif(sys.version_info < (3, 11), reason="usd-core has no wheel for Python 3.10")
class TestAsUsdReadsIt:
    @pytest.fixture
    def path(self, tmp_path: Path) -> str:
        USDZ.write(tmp_path / "a.usdz", MAPS, Options())
        return str(tmp_path / "a.usdz")

    def test_surface_is_that_of_the_glb_and_stands_on_the_ground(self, path: str, tmp_path: Path) -> None:
        from pxr import Usd, UsdGeom

        stage = Usd.Stage.Open(path)
        assert UsdGeom.GetStageMetersPerUnit(stage) == 1
        assert UsdGeom.GetStageUpAxis(stage) == "Y"
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/photo/surface"))
        vertices, faces, uv = surface_of_glb(tmp_path / "a.glb")
        np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get()), vertices, atol=5.1e-7)
        np.testing.assert_array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), faces)
        st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
        assert st.GetInterpolation() == "vertex"
        np.testing.assert_allclose(np.array(st.Get()), uv * (1, -1) + (0, 1), atol=5.1e-7)
        cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"])
        box = cache.ComputeWorldBound(stage.GetDefaultPrim()).ComputeAlignedRange()
        np.testing.assert_allclose(np.array(box.GetSize()), np.ptp(vertices, axis=0), atol=1e-5)
        np.testing.assert_allclose((box.GetMin()[1], *np.array(box.GetMidpoint())[[0, 2]]), 0, atol=1e-6)

    def test_photo_shines_in_its_own_light(self, path: str) -> None:
        from pxr import Ar, Usd, UsdShade

        stage = Usd.Stage.Open(path)
        bound, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/photo/surface")).ComputeBoundMaterial()
        surface, *_ = bound.ComputeSurfaceSource()
        assert surface.GetIdAttr().Get() == "UsdPreviewSurface"
        assert tuple(surface.GetInput("diffuseColor").Get()) == (0, 0, 0)
        texture = UsdShade.Shader(surface.GetInput("emissiveColor").GetConnectedSources()[0][0].source.GetPrim())
        assert texture.GetInput("sourceColorSpace").Get() == "sRGB"
        asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(texture.GetInput("file").Get().resolvedPath))
        with Image.open(BytesIO(bytes(asset.GetBuffer()))) as photo:
            assert photo.size == (8, 6)
        place = UsdShade.Shader(texture.GetInput("st").GetConnectedSources()[0][0].source.GetPrim())
        assert place.GetInput("varname").Get() == "st"

    def test_camera_sees_each_point_at_its_place_in_the_photo(self, path: str) -> None:
        from pxr import Gf, Usd, UsdGeom

        stage = Usd.Stage.Open(path)
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/photo/surface"))
        to_world = mesh.ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        seen = UsdGeom.Camera(stage.GetPrimAtPath("/photo/camera")).GetCamera(Usd.TimeCode.Default()).frustum
        to_window = to_world * seen.ComputeViewMatrix() * seen.ComputeProjectionMatrix()
        places = [to_window.Transform(Gf.Vec3d(*map(float, point))) for point in mesh.GetPointsAttr().Get()]
        st = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get())
        np.testing.assert_allclose(np.array(places)[:, :2], 2 * st - 1, atol=1e-5)

    def test_complies(self, path: str) -> None:
        from pxr import Usd, UsdValidation

        validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
        assert any("UsdzPackageValidator" in each.GetMetadata().name for each in validators)
        found = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(path))
        assert [error.GetMessage() for error in found] == []
