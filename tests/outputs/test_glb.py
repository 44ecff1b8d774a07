"""GLB, read by pygltflib and by trimesh, which did not write it."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.mesh import build_mesh
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.glb import GLB, write_glb

GLTF2 = pytest.importorskip("pygltflib").GLTF2
trimesh = pytest.importorskip("trimesh")

SIZE = (6, 8)
CAMERA = Camera(SIZE, 10.0, 11.0, 3.0, 2.5, "exif")
IMAGE = np.full((3, 4, 3), 90, np.uint8)
PLANE = build_mesh(np.full(SIZE, 2, np.float32), CAMERA)
TYPES = {5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


def array(file, number: int) -> np.ndarray:
    """Return the values of an accessor."""
    accessor = file.accessors[number]
    view = file.bufferViews[accessor.bufferView]
    content = file.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    return np.frombuffer(content, TYPES[accessor.componentType]).reshape(accessor.count, WIDTHS[accessor.type])


@pytest.mark.parametrize("max_triangles", [None, 5000])
def test_room_has_its_true_size_and_is_not_mirrored(tmp_path: Path, max_triangles: int | None) -> None:
    pytest.importorskip("embreex")
    if max_triangles:
        pytest.importorskip("fast_simplification")
    from tests.outputs.room import assert_true, rendered_room

    written = GLB.write(tmp_path / "room.glb", rendered_room(), Options(max_triangles=max_triangles))
    scene = trimesh.load(tmp_path / "room.glb")
    (mesh,) = scene.geometry.values()
    assert written.facts == {"triangles": len(mesh.faces)}
    assert max_triangles is None or 0.5 * max_triangles < len(mesh.faces) <= max_triangles
    colors = mesh.visual.to_color().vertex_colors[:, :3]
    opencv = np.asarray(mesh.vertices) * (1, -1, -1)  # y up and z backward, in axes that are right-handed, too
    if max_triangles is None:
        assert_true(opencv, colors)
    # Triangles face the camera at the origin, by their corners' order and by their normals.
    towards = -np.asarray(mesh.triangles_center)
    area = np.asarray(mesh.area_faces)
    assert area[(mesh.face_normals * towards).sum(axis=1) > 0].sum() > 0.999 * area.sum()
    assert ((mesh.vertex_normals * -mesh.vertices).sum(axis=1) > 0).mean() > 0.999
    low, high = mesh.bounds
    np.testing.assert_allclose(high[:2] - low[:2], (4, 2.5), rtol=1e-3)
    np.testing.assert_allclose(low[2], -3, rtol=1e-3)
    assert high[2] < 0


def test_says_all_that_the_standard_asks_for(tmp_path: Path) -> None:
    write_glb(tmp_path / "folder" / "a.glb", PLANE, image=IMAGE)
    file = GLTF2().load(str(tmp_path / "folder" / "a.glb"))
    assert file.asset.version == "2.0"
    (primitive,) = file.meshes[0].primitives
    positions = array(file, primitive.attributes.POSITION)
    accessor = file.accessors[primitive.attributes.POSITION]
    assert (accessor.min, accessor.max) == (positions.min(axis=0).tolist(), positions.max(axis=0).tolist())
    np.testing.assert_array_equal(positions, PLANE.vertices * (1, -1, -1))
    np.testing.assert_allclose(array(file, primitive.attributes.NORMAL), [[0, 0, 1]] * 48, atol=1e-6)
    np.testing.assert_array_equal(array(file, primitive.attributes.TEXCOORD_0), PLANE.uv)
    np.testing.assert_array_equal(array(file, primitive.indices).reshape(-1, 3), PLANE.faces)
    assert all(view.byteOffset % 4 == 0 for view in file.bufferViews)
    assert "KHR_materials_unlit" in file.extensionsUsed
    assert "KHR_materials_unlit" in file.materials[0].extensions
    view = file.bufferViews[file.images[0].bufferView]
    with Image.open(BytesIO(file.binary_blob()[view.byteOffset :][: view.byteLength])) as texture:
        assert (texture.format, texture.size) == ("JPEG", (4, 3))
        assert abs(np.asarray(texture).astype(int) - 90).max() <= 2


def test_camera_sees_what_the_photo_sees(tmp_path: Path) -> None:
    write_glb(tmp_path / "a.glb", PLANE)
    file = GLTF2().load(str(tmp_path / "a.glb"))
    (camera,) = file.cameras
    assert any(node.camera == 0 for node in file.nodes)
    assert np.degrees(camera.perspective.yfov) == pytest.approx(Camera.from_focal(11.0, SIZE).fov_y)
    across = 2 * np.degrees(np.arctan(np.tan(camera.perspective.yfov / 2) * camera.perspective.aspectRatio))
    assert across == pytest.approx(Camera.from_focal(10.0, SIZE).fov_x)
    assert file.asset.extras == {"intrinsics": CAMERA.matrix.tolist(), "size": [6, 8], "cameraSource": "exif"}


def test_of_a_panorama_has_no_camera_and_a_texture_that_goes_round(tmp_path: Path) -> None:
    write_glb(tmp_path / "a.glb", replace(PLANE, camera=None), image=IMAGE)
    file = GLTF2().load(str(tmp_path / "a.glb"))
    assert (file.cameras, file.asset.extras) == ([], {})
    assert [node.camera for node in file.nodes] == [None]
    assert (file.samplers[0].wrapS, file.samplers[0].wrapT) == (10497, 33071)
    write_glb(tmp_path / "a.glb", PLANE, image=IMAGE)
    assert GLTF2().load(str(tmp_path / "a.glb")).samplers[0].wrapS == 33071


def test_normals_have_length_1_even_where_triangles_have_no_area(tmp_path: Path) -> None:
    normals = PLANE.normals * 1.001
    normals[5] = 0
    write_glb(tmp_path / "a.glb", replace(PLANE, normals=normals))
    found = array(GLTF2().load(str(tmp_path / "a.glb")), 2)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
    assert found[5] @ (PLANE.vertices[5] * (1, -1, -1)) == pytest.approx(-np.linalg.norm(PLANE.vertices[5]))


def test_without_a_photo_has_no_texture(tmp_path: Path) -> None:
    write_glb(tmp_path / "a.glb", PLANE)
    file = GLTF2().load(str(tmp_path / "a.glb"))
    assert (file.images, file.textures, file.extensionsUsed) == ([], [], [])
    assert len(trimesh.load(tmp_path / "a.glb").geometry) == 1


def test_mesh_that_is_too_large_for_the_format_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part that says it is larger stands for 4 GiB."""

    class Large(bytes):
        def __len__(self) -> int:
            return 1 << 32

    monkeypatch.setattr("zoedepth.outputs.glb.texture_of", lambda image: Large())
    with pytest.raises(InputError, match="less than 4 GiB"):
        write_glb(tmp_path / "a.glb", PLANE, image=IMAGE)
    assert list(tmp_path.iterdir()) == []


def test_needs_a_surface_and_a_camera(tmp_path: Path) -> None:
    pixel = Maps(depth=np.ones((1, 1), np.float32), camera=Camera.from_focal(1.0, (1, 1)))
    for maps, word in ((pixel, "no surface"), (Maps(depth=np.ones(SIZE, np.float32)), "'camera'")):
        with pytest.raises(InputError, match=word):
            GLB.write(tmp_path / "a.glb", maps, Options())
    assert list(tmp_path.iterdir()) == []
