"""Panoramas from photo to distances, by a predictor that reads them from the colours, and by a tiny model."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from PIL import Image

from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, InputWarning
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.panorama import directions
from zoedepth.images import read_image
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.panorama import PanoramaMap, is_sphere, predict_panorama
from zoedepth.predict import Predictor

HALF = np.array([3.0, 1.4, 2.0])
XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    b'<rdf:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
    b'GPano:ProjectionType="equirectangular"/></rdf:RDF></x:xmpmeta>'
)


def room(rays: np.ndarray) -> np.ndarray:
    """Return the distance of a room's walls along unit rays."""
    return (HALF / np.maximum(np.abs(rays), 1e-9)).min(axis=-1).astype(np.float32)


def colored(height: int) -> np.ndarray:
    """Return a panorama whose colours say in which direction they are seen."""
    return np.rint((directions((height, 2 * height)) + 1) * 127).astype(np.uint8)


class Reader:
    """A predictor that reads the distances of a room from the colours of ``colored``, but for a scale for each view."""

    def __init__(self, *, outdoor: Sequence[int] = ()) -> None:
        self.outdoor = outdoor
        self.scales = np.exp(np.random.default_rng(1).normal(0, 0.05, 22))
        self.calls: list[tuple[int, str | None]] = []

    def batch(self, images: Sequence[np.ndarray], *, domain: str | None, camera: Sequence[Camera]) -> list[DepthMap]:
        self.calls.append((len(images), domain))
        maps = []
        for number, (image, known) in enumerate(zip(images, camera, strict=True)):
            rays = image / 127 - 1
            distance = room(rays / np.linalg.norm(rays, axis=-1, keepdims=True)) * self.scales[number]
            depth = (distance / np.linalg.norm(known.rays(), axis=-1)).astype(np.float32)
            outdoor = 0.9 if number in self.outdoor else 0.2
            own = "outdoor" if outdoor > 0.5 else "indoor"
            maps.append(
                DepthMap(
                    depth, None, domain or own, {"indoor": 1 - outdoor, "outdoor": outdoor}, image, (1, 1), known,
                    depth_range=(0.001, 10.0),
                )
            )  # fmt: skip
        return maps


def read(reader: Reader, image: Any, **options: Any) -> PanoramaMap:
    return predict_panorama(cast(Predictor, reader), image, **options)


@pytest.fixture(scope="module")
def around() -> PanoramaMap:
    return read(Reader(), colored(100))


@pytest.mark.parametrize("sharpest", [1005, 100])
def test_distances_are_those_of_the_room_at_the_size_of_the_photo(
    sharpest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zoedepth.panorama.sharp_height", lambda view: sharpest)  # what is finer is reduced
    height = 150
    image = colored(height)
    result = read(Reader(), image)
    truth = room(directions((height, 2 * height)))
    assert result.size == truth.shape
    assert result.distance.dtype == np.float32
    ratio = result.distance / truth
    assert np.abs(ratio / np.median(ratio) - 1).mean() < 0.025
    assert abs(np.median(ratio) - 1) < 0.05
    assert result.disagreement < 0.03
    assert result.scales.shape == (22,)
    assert np.array_equal(result.image, image)
    steps = np.abs(np.diff(np.log(result.distance), axis=1, append=np.log(result.distance[:, :1]))).mean(axis=0)
    assert steps[-1] < 2 * steps.mean()


def test_all_views_take_the_head_that_the_router_finds_in_them_together() -> None:
    reader = Reader(outdoor=[2, 5, 7])
    result = read(reader, colored(100))
    assert result.domain == "indoor"
    assert reader.calls == [(22, None), (3, "indoor")]
    reader = Reader()
    assert read(reader, colored(100), domain="outdoor").domain == "outdoor"
    assert reader.calls == [(22, "outdoor")]


def test_a_panorama_gives_points_normals_and_a_surface(around: PanoramaMap) -> None:
    result = around
    assert result.valid.mean() > 0.95
    away = np.linalg.norm(result.points, axis=-1)
    np.testing.assert_allclose(away, result.distance, rtol=1e-5)
    towards = (result.normals * result.points).sum(-1)[result.valid]
    assert (towards < 0).all()
    mesh = result.mesh(max_triangles=None)
    assert len(mesh.faces) > 0.9 * 2 * 100 * 200
    assert mesh.camera is None
    assert result.preview().shape[2] == 3


def test_what_is_beyond_the_range_is_not_valid() -> None:
    distance = np.full((20, 40), 2.0, np.float32)
    distance[3] = 0.5
    result = PanoramaMap(distance, np.zeros((20, 40, 3), np.uint8), "indoor", np.ones(22), 0.0, (1.0, math.inf))
    assert not result.valid[3].any()
    assert result.valid[6:].all()


@pytest.mark.parametrize("suffix", ["glb", "html", "ply", "pcd", "npy", "npz", "png", "jpg"])
def test_panoramas_are_saved_by_suffix(tmp_path: Path, suffix: str, around: PanoramaMap) -> None:
    result = around
    result.save(tmp_path / f"room.{suffix}", max_triangles=10**6)
    assert (tmp_path / f"room.{suffix}").stat().st_size > 1000
    if suffix == "npy":
        assert np.array_equal(np.load(tmp_path / "room.npy"), result.distance)
    if suffix == "ply":
        trimesh = pytest.importorskip("trimesh")
        cloud = trimesh.load(tmp_path / "room.ply")
        np.testing.assert_allclose(cloud.vertices, result.points[result.valid], rtol=1e-6)


def test_a_file_that_says_it_is_a_panorama_is_one(tmp_path: Path) -> None:
    for name, height, width, xmp in (("sphere", 40, 80, XMP), ("strip", 20, 80, XMP), ("photo", 40, 80, None)):
        picture = Image.fromarray(np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8))
        picture.save(tmp_path / f"{name}.jpg", **({} if xmp is None else {"xmp": xmp}))
    assert is_sphere(tmp_path / "sphere.jpg")
    with (tmp_path / "sphere.jpg").open("rb") as file:
        assert is_sphere(file)
    assert not is_sphere(tmp_path / "strip.jpg")
    assert not is_sphere(tmp_path / "photo.jpg")


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({"ProjectionType": "cylindrical"}, False),
        ({"CroppedAreaImageWidthPixels": 80, "FullPanoWidthPixels": 160, "CroppedAreaImageHeightPixels": 40,
          "FullPanoHeightPixels": 80}, False),
        ({"CroppedAreaImageHeightPixels": 40, "FullPanoHeightPixels": 80}, False),
        ({"ProjectionType": "Equirectangular", "CroppedAreaImageWidthPixels": 80, "FullPanoWidthPixels": 80,
          "CroppedAreaImageHeightPixels": 40, "FullPanoHeightPixels": 40}, True),
        ({"CroppedAreaImageWidthPixels": 80}, True),
    ],
)  # fmt: skip
def test_a_part_of_a_sphere_is_none_however_it_is_shaped(
    tmp_path: Path, said: dict[str, object], expected: bool
) -> None:
    about = {"ProjectionType": "equirectangular", **said}
    notes = " ".join(f'GPano:{name}="{value}"' for name, value in about.items())
    attributes = f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF {notes}></rdf:RDF></x:xmpmeta>'
    as_elements = re.sub(r'(GPano:\w+)="(\w+)"', r"<\1>\2</\1>", attributes.replace("<rdf:RDF ", "<rdf:RDF>"))
    for number, xmp in enumerate((attributes, as_elements)):
        path = tmp_path / f"{number}.jpg"
        Image.fromarray(np.zeros((40, 80, 3), np.uint8)).save(path, xmp=xmp.encode())
        assert is_sphere(path) == expected


@pytest.mark.filterwarnings("error::zoedepth.errors.InputWarning")
def test_nothing_is_said_about_a_panorama_that_is_expected(tmp_path: Path) -> None:
    Image.fromarray(colored(60)).save(tmp_path / "sphere.png", xmp=XMP)
    Image.fromarray(colored(60)).save(tmp_path / "sphere.jpg", xmp=XMP)
    assert read_image(tmp_path / "sphere.jpg", panorama=True).shape == (60, 120, 3)
    with (tmp_path / "sphere.jpg").open("rb") as file:
        assert read(Reader(), file).size == (60, 120)
    with pytest.warns(InputWarning, match="panorama"):
        read_image(tmp_path / "sphere.jpg")


def test_other_shapes_are_refused() -> None:
    with pytest.raises(InputError, match="twice as wide as high"):
        read(Reader(), np.random.default_rng(0).integers(0, 256, (60, 100, 3), dtype=np.uint8))


def test_a_real_predictor_knows_the_camera_of_every_view(tiny_model: ZoeDepth) -> None:
    predictor = Predictor(tiny_model, flip_average=False)
    seen: list[Camera] = []
    batch = predictor.batch

    def kept(images: Any, **options: Any) -> list[DepthMap]:
        maps = batch(images, **options)
        seen.extend(depth_map.camera for depth_map in maps)
        return maps

    image = np.random.default_rng(0).integers(0, 256, (32, 64, 3), dtype=np.uint8)
    result = predict_panorama(cast(Predictor, SimpleNamespace(batch=kept)), image)
    assert result.distance.shape == (32, 64)
    assert (result.distance > 0).all()
    assert result.domain in ("indoor", "outdoor")
    assert len(seen) >= 22
    assert {camera.source for camera in seen} == {"given"}
    assert all(camera.fov_x == pytest.approx(90) for camera in seen)
