from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.outputs import Maps
from zoedepth.outputs.surface import MAX_TEXTURE, check_surface, surface_of, texture_of, unit_normals, written_surface

SIZE = (6, 8)
MAPS = Maps(depth=np.full(SIZE, 2, np.float32), camera=Camera.from_focal(10.0, SIZE))


def test_surface_is_made_of_valid_pixels() -> None:
    depth = np.full(SIZE, 2, np.float32)
    depth[:, :4] = 9
    mesh = surface_of(Maps(depth=depth, camera=MAPS.camera, depth_range=(0, 5)), None)
    assert len(mesh.faces) == 5 * 3 * 2
    assert mesh.vertices[:, 2].max() == 2
    with pytest.raises(InputError, match="'camera'"):
        surface_of(Maps(depth=depth), None)


def test_panorama_is_all_around() -> None:
    mesh = surface_of(Maps(depth=np.full((20, 40), 2, np.float32), panorama=True), None)
    assert mesh.camera is None
    np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [[-2] * 3, [2] * 3], atol=0.03)


def test_surface_without_a_triangle_is_refused() -> None:
    mesh = surface_of(MAPS, None)
    check_surface(mesh)
    with pytest.raises(InputError, match="no surface"):
        check_surface(replace(mesh, faces=mesh.faces[:0]))


def test_photo_is_reduced_to_what_browsers_show_and_that_is_said() -> None:
    image = np.full((40, MAX_TEXTURE * 2, 3), 90, np.uint8)
    with Image.open(BytesIO(texture_of(image))) as texture:
        assert (texture.format, texture.size) == ("JPEG", (MAX_TEXTURE, 20))
        assert abs(np.asarray(texture).astype(int) - 90).max() <= 2
    mesh = surface_of(MAPS, None)
    assert "4096 pixels" in " ".join(written_surface(mesh, Maps(image=image)).notes)
    small = written_surface(mesh, Maps(image=image[:, :MAX_TEXTURE]))
    assert (small.facts, small.notes) == ({"triangles": 70}, ())


def test_normals_without_length_point_to_the_camera() -> None:
    mesh = surface_of(MAPS, None)
    normals = mesh.normals * 1.001
    normals[5] = 0
    found = unit_normals(replace(mesh, normals=normals))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(found[5], -mesh.vertices[5] / np.linalg.norm(mesh.vertices[5]), atol=1e-6)
