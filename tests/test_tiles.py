"""Large photos in tiles: a network that reads depth from the colours, blurred by its size, and a tiny real one."""

import dataclasses
import tracemalloc
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import pytest
from PIL import Image
from tests.forward.test_arrays import Brightness

from zoedepth.config import ModelConfig
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, InputWarning
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.lens import Lens
from zoedepth.images import ImageArray, to_image
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.tiles import MOST_AUTO, OVERLAP, Grid, _lines, agree, predict_tiled, read_tiles

SEEN = (24, 32)


class Reader:
    """A predictor that reads depth from the colours as a network does that sees photos at ``SEEN``: 1 m + red / 64.

    Each of its tiles is wrong by a factor of its own.
    """

    def __init__(self, *, wrong: float = 0.0, camera: Camera | None = None, std: bool = True) -> None:
        self.wrong, self.camera, self.std = wrong, camera, std
        self.rng = np.random.default_rng(0)
        self.cameras: list[Camera] = []

    def __call__(self, image: Any, *, domain: str | None = None, camera: Camera | None = None) -> DepthMap:
        return self.read(to_image(image), domain or "indoor", camera or self.camera)

    def parts(self, images: Sequence[ImageArray], cameras: Sequence[Camera], *, domain: str) -> list[DepthMap]:
        self.cameras += cameras
        maps = []
        for image, camera in zip(images, cameras, strict=True):
            found = self.read(image, domain, camera)
            scale = np.float32(np.exp(self.rng.normal(0, self.wrong)))
            maps.append(dataclasses.replace(found, depth=scale * found.depth))
        return maps

    def read(self, image: ImageArray, domain: str, camera: Camera | None) -> DepthMap:
        size = (image.shape[0], image.shape[1])
        red = Image.fromarray(image[..., 0]).convert("F").resize((SEEN[1], SEEN[0]), Image.Resampling.BILINEAR)
        depth = 1 + np.asarray(red.resize((size[1], size[0]), Image.Resampling.BILINEAR)) / np.float32(64)
        return DepthMap(
            depth, 0.1 * depth if self.std else None, domain, {"indoor": 1.0}, image, SEEN,
            camera or Camera.from_fov(size, horizontal=60, source="assumed"), depth_range=(0.5, 10.0),
        )  # fmt: skip


def tiled(reader: Reader, image: Any, **options: Any) -> DepthMap:
    return predict_tiled(cast(Predictor, reader), image, **options)


def photo(red: np.ndarray) -> ImageArray:
    """Return a photo whose red says the depth."""
    return np.repeat(np.rint(red).clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


def ramp(height: int, width: int) -> ImageArray:
    """Return a photo of a slope, near on the left and far on the right."""
    return photo(np.tile(np.linspace(0, 255, width), (height, 1)))


def fence(height: int, width: int) -> ImageArray:
    """Return a photo of posts, so thin that they are a blur in the whole, in front of a slope."""
    red = np.tile(np.linspace(100, 255, width), (height, 1))
    red[:, np.arange(width) % 8 < 4] *= 0.5
    return photo(red)


def truth(image: ImageArray) -> np.ndarray:
    return 1 + image[..., 0] / np.float32(64)


@pytest.mark.parametrize("wrong", [0.0, 0.2])
@pytest.mark.parametrize("size", [(96, 128), (101, 131), (149, 97)])
def test_what_is_flat_or_a_slope_stays_so_without_seams(size: tuple[int, int], wrong: float) -> None:
    for image in (ramp(*size), photo(np.full(size, 90.0))):
        whole = Reader()(image)
        result = tiled(Reader(wrong=wrong), image, tiles=(3, 4))
        assert result.tiles == (3, 4)
        assert result.depth.shape == size
        assert result.depth.dtype == np.float32
        np.testing.assert_allclose(result.depth, truth(image), rtol=0.05)
        for axis in (0, 1):
            ours, theirs = (np.abs(np.diff(np.log(x), 2, axis=axis)).max() for x in (result.depth, whole.depth))
            assert ours < theirs + 0.005


def test_tiles_show_what_the_whole_does_not_and_keep_its_metres() -> None:
    image = fence(96, 128)
    whole, result = Reader()(image), tiled(Reader(wrong=0.2), image, tiles=(4, 4))
    errors = [np.abs(np.log(found.depth / truth(image))).mean() for found in (whole, result)]
    assert errors[1] < 0.6 * errors[0]
    assert abs(np.log(result.depth / whole.depth).mean()) < 0.01


def test_a_tile_that_is_the_whole_is_not_changed() -> None:
    rng = np.random.default_rng(0)
    log = rng.normal(0, 1, (40, 50)).astype(np.float32)
    np.testing.assert_allclose(agree(log, log, (4.0, 4.0)), log, atol=1e-6)
    np.testing.assert_allclose(agree(log + 2, log, (4.0, 4.0)), log, atol=1e-5)
    np.testing.assert_allclose(agree(log[:3, :2], log[:3, :2] + 1, (4.0, 4.0)), log[:3, :2] + 1, atol=1e-5)


def test_the_deviation_is_as_large_a_part_of_the_depth_as_before() -> None:
    image = fence(96, 128)
    result = tiled(Reader(), image, tiles=(2, 3))
    assert result.std is not None
    np.testing.assert_allclose(result.std / result.depth, 0.1, rtol=1e-5)
    assert tiled(Reader(std=False), image, tiles=(2, 3)).std is None


def test_depth_stays_within_the_range_of_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = Reader()
    read = reader.read
    monkeypatch.setattr(reader, "read", lambda *given: dataclasses.replace(read(*given), depth_range=(2.0, 3.0)))
    result = tiled(reader, fence(96, 128), tiles=(4, 4))
    assert result.depth.min() == 2.0
    # What lies beyond the far end is not valid, with tiles and without: its metres stay as they are.
    far = truth(fence(96, 128)) > 3.5
    assert not result.valid[far].any()
    assert result.depth.max() > 3.5


def test_each_tile_is_seen_by_its_own_camera_and_the_head_of_the_whole() -> None:
    camera = Camera((96, 128), 100.0, 101.0, 60.0, 50.0)
    reader = Reader(camera=camera)
    result = tiled(reader, fence(96, 128), tiles=(2, 3), domain="outdoor")
    grid = Grid((96, 128), 2, 3)
    assert reader.cameras == [camera.cropped(top, left, grid.tile) for top in grid.tops for left in grid.lefts]
    assert result.camera == camera
    assert result.domain == "outdoor"


@pytest.mark.parametrize(("side", "count"), [(100, 1), (101, 2), (97, 3), (1000, 7), (64, 32)])
def test_tiles_cover_the_photo_and_overlap(side: int, count: int) -> None:
    grid = Grid((side, side), count, count)
    starts, length = grid.tops, grid.tile[0]
    assert (starts[0], starts[-1] + length) == (0, side)
    assert len(starts) == count
    assert all(one < other <= one + length for one, other in pairwise(starts))
    if side > 10 * count:
        overlaps = [one + length - other for one, other in pairwise(starts)]
        assert all(abs(overlap - OVERLAP * length) <= 2 for overlap in overlaps)
    total = np.zeros(side)
    for start, weights in zip(starts, grid.windows[0], strict=True):
        assert weights.min() >= 0
        total[start : start + length] += weights
    np.testing.assert_allclose(total, 1, rtol=1e-6)


@pytest.mark.parametrize(
    ("size", "taken"), [((24, 32), None), ((30, 40), None), ((40, 54), (2, 2)), ((500, 800), (4, 4))]
)
def test_auto_takes_as_many_as_the_photo_is_worth(size: tuple[int, int], taken: tuple[int, int] | None) -> None:
    image = ramp(*size)
    result = tiled(Reader(), image)
    assert result.tiles == taken
    assert MOST_AUTO == 4
    if taken is None:
        np.testing.assert_array_equal(result.depth, Reader()(image).depth)


def test_tiles_that_show_nothing_more_are_refused() -> None:
    with pytest.raises(InputError, match="are 10 pixels high, less than half of what the network sees"):
        tiled(Reader(), ramp(30, 40), tiles=(4, 4))


@pytest.mark.parametrize(("word", "tiles"), [("auto", "auto"), ("1x1", (1, 1)), ("4x6", (4, 6)), ("32x32", (32, 32))])
def test_words(word: str, tiles: object) -> None:
    assert read_tiles(word) == tiles


@pytest.mark.parametrize("word", ["", "4", "4x", "0x4", "4x4x4", "33x4", "-4x4", "4 x 4", "four", "04x4", "4x٤"])
def test_other_words_are_refused(word: str) -> None:
    with pytest.raises(InputError, match="tiles"):
        read_tiles(word)


@pytest.mark.parametrize("tiles", [(4,), (0, 4), (4, 33), (4.0, 4), "4x4", None])
def test_other_tiles_are_refused(unchecked_types: None, tiles: Any) -> None:
    with pytest.raises(InputError, match="tiles must be 'auto' or"):
        tiled(Reader(), ramp(96, 128), tiles=tiles)


def test_memory_is_that_of_a_row_of_tiles() -> None:
    whole = Reader()(fence(512, 1024))
    grid = Grid(whole.size, 16, 4)
    tracemalloc.start()
    try:
        tops = [lines.start for lines, _ in _lines(cast(Predictor, Reader()), whole, grid)]
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert tops == grid.tops
    assert peak < 0.6 * whole.depth.nbytes
    assert grid.tile[0] < 512 / 12


@pytest.mark.filterwarnings("error::zoedepth.errors.InputWarning")
def test_a_real_predictor_and_a_turned_photo_with_plain_sky(tiny_model: ZoeDepth, tmp_path: Path) -> None:
    image = np.full((160, 256, 3), 200, np.uint8)
    image[80:] = np.random.default_rng(0).integers(0, 256, (80, 256, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(image).save(tmp_path / "turned.png", exif=exif)
    predictor = Predictor(tiny_model, flip_average=False)
    plain, result = predictor(tmp_path / "turned.png"), predict_tiled(predictor, tmp_path / "turned.png", tiles=(3, 2))
    assert result.size == plain.size == (256, 160)
    np.testing.assert_array_equal(result.image, plain.image)
    assert (result.domain, result.camera, result.network_size) == (plain.domain, plain.camera, plain.network_size)
    assert np.isfinite(result.depth).all()
    assert not np.array_equal(result.depth, plain.depth)
    assert np.log(result.depth / plain.depth).mean() == pytest.approx(0, abs=0.05)
    with pytest.warns(InputWarning, match="of one colour"):
        predictor(image[:80])


@pytest.mark.parametrize("resize", ["keep-aspect", "squeeze"])
def test_an_exported_model_whose_depth_follows_the_camera(
    tiny_config: ModelConfig, resize: Literal["keep-aspect", "squeeze"]
) -> None:
    """The tile's lens is longer, so that its depth is corrected by more; its metres are those of the whole."""
    domains = tuple(dataclasses.replace(domain, focal_px=50.0) for domain in tiny_config.domains)
    model = Brightness(dataclasses.replace(tiny_config, domains=domains, canonical_camera=True))
    predictor = Predictor(model, resize=resize, camera=Lens(fov_x=70))
    image = fence(300, 401)
    whole = predictor(image, domain="indoor")
    result = predict_tiled(predictor, image, tiles=(4, 4), domain="indoor")
    assert (result.domain, result.camera) == (whole.domain, whole.camera)
    assert result.focal_correction == whole.focal_correction != 1
    assert whole.std is not None
    assert result.std is not None
    np.testing.assert_allclose(result.std / result.depth, whole.std / whole.depth, rtol=1e-4)
    assert abs(np.log(result.depth / whole.depth).mean()) < 0.01
    errors = [
        np.abs(np.log(found.depth / found.focal_correction / (1 + image[..., 0] / 255))) for found in (whole, result)
    ]
    assert errors[1].mean() < 0.8 * errors[0].mean()
