"""From any photo to a depth map of its size. Two models: one whose depth is the brightness, and a tiny real one."""

import copy
import dataclasses
import io
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from threading import Barrier, Thread
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from torch import Tensor, nn

from zoedepth.config import INDOOR, OUTDOOR, ModelConfig, NaiveConfig, RouterConfig
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.forward.tensors import TensorForward
from zoedepth.geometry.camera import Camera, Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.model.zoedepth import DepthOutput, ZoeDepth
from zoedepth.predict import Predictor


class Brightness(ZoeDepth):
    """Depth is 1 m + the red channel in metres, ten times that outdoors, with a standard deviation of 10 %.

    Outdoors is where the left edge is brighter than the right one.
    """

    def __init__(self, *, antialias: bool = False, canonical: bool = False, focal_px: float | None = None) -> None:
        nn.Module.__init__(self)
        self.config = SimpleNamespace(
            size=(64, 96),
            multiple=32,
            keep_aspect_ratio=True,
            antialias=antialias,
            pad=True,
            domains=tuple(replace(domain, focal_px=focal_px) for domain in (INDOOR, OUTDOOR)),
            router=RouterConfig(),
            canonical_camera=canonical,
        )
        self.weight = nn.Parameter(torch.ones(1))
        self.n_images = 0
        self.eval()

    def forward(
        self,
        pixels: Tensor,
        *,
        domain: Tensor | None = None,
        return_std: bool = False,
        return_bins: bool = False,
    ) -> DepthOutput:
        assert not any(side % 32 for side in pixels.shape[-2:])
        assert pixels.min() >= 0
        assert pixels.max() <= 1
        self.n_images += len(pixels)
        edges = pixels[..., 0].mean(dim=(1, 2)) - pixels[..., -1].mean(dim=(1, 2))
        # 1e-5: not to be decided by rounding where both edges are equal.
        logits = torch.stack([torch.full_like(edges, 1e-5), 10 * edges], dim=1)
        chosen = logits.argmax(dim=1) if domain is None else domain
        depth = (1 + pixels[:, :1]) * torch.where(chosen == 1, 10.0, 1.0)[:, None, None, None]
        return DepthOutput(depth, 1 / depth, chosen, logits, 0.1 * depth, None, None)


@pytest.fixture
def brightness() -> Brightness:
    return Brightness()


def smooth(size: tuple[int, int], seed: int = 0) -> np.ndarray:
    """A photo without fine detail, darker on the left: uint8 (height, width, 3)."""
    small = np.random.default_rng(seed).integers(60, 200, (4, 6, 3), dtype=np.uint8)
    small[:, 0], small[:, -1] = 20, 230
    return np.array(Image.fromarray(small).resize(size[::-1], Image.Resampling.BILINEAR))


def assert_same(a: DepthMap, b: DepthMap, atol: float = 0.0) -> None:
    np.testing.assert_allclose(a.depth, b.depth, atol=atol, rtol=1e-5 if atol else 0)
    np.testing.assert_allclose(a.std, b.std, atol=max(atol, 1e-6))
    assert a.domain == b.domain


# ------------------------------------------------------------------------------------------------ one photo, one depth


def test_path_pil_array_and_tensor_give_one_depth(tiny_model: ZoeDepth, tmp_path: Path) -> None:
    photo = smooth((50, 70))
    Image.fromarray(photo).save(tmp_path / "photo.png")
    tensor = torch.from_numpy(photo).permute(2, 0, 1)
    predictor = Predictor(tiny_model)
    expected = predictor(photo)
    for source in (
        tmp_path / "photo.png",
        str(tmp_path / "photo.png"),
        io.BytesIO((tmp_path / "photo.png").read_bytes()),
        Image.fromarray(photo),
        photo / 255,
        tensor,
        tensor.float() / 255,
    ):
        assert_same(predictor(source), expected)


def test_mirrored_photo_gives_mirrored_depth(tiny_model: ZoeDepth, brightness: Brightness) -> None:
    for model in (tiny_model, brightness):
        photo = smooth((70, 90))
        result, mirrored = Predictor(model).batch([photo, photo[:, ::-1]])
        np.testing.assert_allclose(result.depth, mirrored.depth[:, ::-1], rtol=1e-4)
        np.testing.assert_allclose(result.std, mirrored.std[:, ::-1], rtol=1e-2, atol=1e-4)
        assert result.domain == mirrored.domain


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    """Number of threads that torch computes with, until the test ends."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.mark.parametrize("together", [True, False])
def test_batch_equals_singles(
    tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch, threads: int, together: bool
) -> None:
    """Together, as on an accelerator, and one by one, as on the CPU."""
    if together:
        monkeypatch.setattr(TensorForward, "_one_by_one", False)
    sizes = [(50, 70), (51, 70), (70, 50), (50, 70), (30, 90), (50, 71), (1, 1)]
    photos = [smooth(size, seed) for seed, size in enumerate(sizes)]
    predictor = Predictor(tiny_model)
    singles = [predictor(photo) for photo in photos]
    for batch_size in (3, 16):
        results = predictor.batch(photos, batch_size=batch_size)
        for photo, result, single in zip(photos, results, singles, strict=True):
            np.testing.assert_array_equal(result.image, photo)
            assert_same(result, single, atol=1e-5)
    assert predictor.batch([]) == []
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize("threads", [3], indirect=True)
def test_photos_of_a_batch_share_the_cores(tiny_model: ZoeDepth, threads: int) -> None:
    """Two at a time have one thread each; each is alone in its forward."""
    barrier, seen = Barrier(2, timeout=60), []

    def note(model: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        barrier.wait()  # until two are here
        seen.append((torch.get_num_threads(), len(inputs[0])))

    hook = tiny_model.register_forward_pre_hook(note)
    Predictor(tiny_model, flip_average=False).batch([smooth((40, 60), seed) for seed in range(4)], batch_size=2)
    hook.remove()
    assert seen == [(1, 1)] * 4


@pytest.mark.parametrize("batch_size", [0, -1])
def test_a_batch_has_at_least_one_photo(tiny_model: ZoeDepth, batch_size: int) -> None:
    with pytest.raises(InputError, match="batch_size must be 1 or more"):
        Predictor(tiny_model).batch([smooth((40, 60))], batch_size=batch_size)


def test_infer_equals_call(tiny_model: ZoeDepth) -> None:
    """Tensors in, tensors out, with the router's heads or given ones."""
    photos = [smooth((50, 70), seed) for seed in range(3)]
    pixels = torch.stack([torch.from_numpy(photo).permute(2, 0, 1) for photo in photos]) / 255
    predictor = Predictor(tiny_model)
    for domain, heads in ((None, None), ("outdoor", torch.tensor([1, 1, 1]))):
        with torch.no_grad():
            depth = predictor.infer(pixels, domain=heads)
        assert depth.shape == (3, 1, 50, 70)
        for row, photo in enumerate(photos):
            # Three photos at once may be summed in another order than one.
            np.testing.assert_allclose(depth[row, 0], predictor(photo, domain=domain).depth, rtol=1e-4)


@pytest.mark.parametrize("pixels", ["0 to 255", "normalised", "not a number"])
def test_pixels_out_of_range_are_refused(tiny_model: ZoeDepth, pixels: str) -> None:
    photo = torch.rand(1, 3, 40, 60, generator=torch.Generator().manual_seed(0))
    wrong = {"0 to 255": photo * 255, "normalised": photo * 4.6 - 2.1, "not a number": photo / 0 - photo / 0}[pixels]
    with pytest.raises(InputError, match=r"pixels are in \[.*\] and must be RGB in \[0, 1\]"):
        Predictor(tiny_model).infer(wrong)
    assert Predictor(tiny_model).infer(photo * 1.2 - 0.1).isfinite().all()  # resizing overshoots by as much


@pytest.mark.parametrize("images", ["photo.jpg", Path("photo.jpg"), b"content"], ids=repr)
def test_a_batch_is_a_list(tiny_model: ZoeDepth, images: object) -> None:
    with pytest.raises(InputError, match="batch takes a list of photos"):
        Predictor(tiny_model).batch(images)


def test_threads_share_one(tiny_model: ZoeDepth) -> None:
    predictor, photos, results = Predictor(tiny_model), [smooth((40, 60), seed) for seed in range(6)], {}

    def run(index: int) -> None:
        results[index] = predictor(photos[index])

    threads = [Thread(target=run, args=(index,)) for index in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for index, photo in enumerate(photos):
        assert_same(results[index], predictor(photo), atol=1e-5)


# ---------------------------------------------------------------------------------------------------- where depth lies


@pytest.mark.parametrize("pad", [True, False])
@pytest.mark.parametrize("antialias", [True, False])
@pytest.mark.parametrize("size", [(64, 96), (128, 192), (97, 131), (200, 150)])
def test_depth_lies_where_the_photo_is(size: tuple[int, int], antialias: bool, pad: bool) -> None:
    """A model that copies the photo gives the photo back: padding, mirroring and resizing are undone."""
    photo = smooth(size)
    result = Predictor(Brightness(antialias=antialias), pad=pad)(photo, domain="indoor")
    assert result.depth.shape == size == result.size
    np.testing.assert_allclose(result.depth, 1 + photo[..., 0] / 255, atol=0.06)
    assert abs(result.depth - 1 - photo[..., 0] / 255).mean() < 0.01


@pytest.mark.parametrize("pad", [True, False])
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (2, 3), (33, 47), (24, 120)])
def test_any_size(tiny_model: ZoeDepth, size: tuple[int, int], pad: bool) -> None:
    result = Predictor(tiny_model, pad=pad, flip_average=False)(smooth(size))
    for values in (result.depth, result.std, result.confidence):
        assert values.shape == size
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
    assert result.depth.min() >= 1e-3
    assert result.std.min() >= 0


@settings(max_examples=25, deadline=None)
@given(height=st.integers(1, 150), width=st.integers(1, 150), pad=st.booleans(), flip=st.booleans())
def test_any_size_of_constant_photo_is_constant(height: int, width: int, pad: bool, flip: bool) -> None:
    photo = np.full((height, width, 3), 102, np.uint8)
    result = Predictor(Brightness(), pad=pad, flip_average=flip)(photo)
    assert result.domain == "indoor"
    np.testing.assert_allclose(result.depth, 1.4, rtol=1e-5)
    np.testing.assert_allclose(result.std, 0.14, rtol=1e-4)


def test_padding_and_network_size_are_the_released_ones(brightness: Brightness) -> None:
    """3 sqrt(side / 2), reflected: 480 x 640 becomes 572 x 746."""
    seen = []
    hook = brightness.register_forward_pre_hook(lambda _, args: seen.append(args[0]))
    photo = smooth((480, 640))
    result = Predictor(brightness, flip_average=False)(photo)
    hook.remove()
    padded = np.pad(photo, ((46, 46), (53, 53), (0, 0)), mode="reflect")
    pixels = torch.from_numpy(padded).permute(2, 0, 1)[None].float() / 255
    expected = nn.functional.interpolate(pixels, result.network_size, mode="bilinear", align_corners=True)
    torch.testing.assert_close(seen[0], expected)
    assert result.network_size == (64, 96)


def test_photo_too_long_and_narrow_is_refused_before_it_fills_the_memory(tiny_model: ZoeDepth) -> None:
    with pytest.raises(InputError, match="4000 x 64 pixels is too long"):
        Predictor(tiny_model)(np.zeros((64, 4000, 3), dtype=np.uint8))


def test_overshoot_stays_positive() -> None:
    """Bicubic resizing of a step from far to near would dip below zero."""

    class Step(Brightness):
        def forward(self, pixels: Tensor, **options: object) -> DepthOutput:
            output = super().forward(pixels, **options)
            return output._replace(depth=torch.where(pixels[:, :1] > 0.5, 80.0, 1e-3))

    photo = np.zeros((256, 384, 3), np.uint8)
    photo[:, 192:] = 255
    assert Predictor(Step())(photo).depth.min() == np.float32(1e-3)


# --------------------------------------------------------------------------------------------------------- uncertainty


def test_std_and_confidence(brightness: Brightness) -> None:
    result = Predictor(brightness, flip_average=False)(np.full((20, 30, 3), 51, np.uint8))
    np.testing.assert_allclose(result.std, 0.1 * 1.2, rtol=1e-4)
    np.testing.assert_allclose(result.confidence, 1 / 1.1, rtol=1e-4)


def test_head_without_distribution_has_neither(tiny_config: ModelConfig, tmp_path: Path) -> None:
    model = ZoeDepth(dataclasses.replace(tiny_config, head=NaiveConfig())).eval()
    photo = np.zeros((50, 70, 3), np.uint8)
    for flip in (True, False):
        result = Predictor(model, flip_average=flip)(photo)
        assert result.std is None
        assert result.confidence is None
    result.save(tmp_path / "depth.npz")
    with np.load(tmp_path / "depth.npz") as arrays:
        assert "depth" in arrays
        assert not {"std", "confidence"} & set(arrays)


def test_copies_that_disagree_add_to_the_std() -> None:
    class Drifting(Brightness):
        """Adds 0 m at the left and 1 m at the right, so that the mirrored copy disagrees at the edges."""

        def forward(self, pixels: Tensor, **options: object) -> DepthOutput:
            output = super().forward(torch.zeros_like(pixels), **options)
            drift = torch.linspace(0, 1, pixels.shape[-1]).expand_as(output.depth)
            return output._replace(depth=output.depth + drift, std=torch.zeros_like(output.depth))

    result = Predictor(Drifting(), pad=False)(np.zeros((64, 96, 3), np.uint8))
    np.testing.assert_allclose(result.depth, 1.5, rtol=1e-5)
    np.testing.assert_allclose(result.std[0, [0, -1]], 0.5, rtol=1e-3)
    assert result.std[0, 47:49].max() < 0.01


# ------------------------------------------------------------------------------------------------------------- domains


def test_both_copies_take_the_head_of_their_mean_logits(brightness: Brightness) -> None:
    """Alone, the mirrored copy of this photo would go outdoors, and the mean be ten metres off."""
    photo = smooth((64, 96))
    result = Predictor(brightness)(photo)
    assert result.domain == "indoor"
    assert result.depth.max() < 2.1
    assert brightness.n_images == 3, "the copy that took another head is run again, and only that one"
    assert result.domain_probability == pytest.approx({"indoor": 0.5, "outdoor": 0.5}, abs=1e-5)


def test_given_domain(brightness: Brightness) -> None:
    photo = smooth((64, 96))
    indoor, outdoor = (Predictor(brightness)(photo, domain=name) for name in ("indoor", "outdoor"))
    assert (indoor.domain, outdoor.domain) == ("indoor", "outdoor")
    np.testing.assert_allclose(outdoor.depth, 10 * indoor.depth, rtol=1e-5)
    assert brightness.n_images == 4
    with pytest.raises(InputError, match=r"no head for 'moon'.*indoor"):
        Predictor(brightness)(photo, domain="moon")


def test_each_photo_of_a_batch_takes_its_own_head(brightness: Brightness) -> None:
    photo = smooth((64, 96))
    results = Predictor(brightness, flip_average=False).batch([photo, photo[:, ::-1], photo])
    assert [result.domain for result in results] == ["indoor", "outdoor", "indoor"]


# ------------------------------------------------------------------------------------------------------------- cameras

FOCAL_PX = 80.0
"""Of the training photos in these tests, in pixels of the network's input."""


def taken_with(path: Path, film_focal: object, *, size: tuple[int, int] = (64, 96)) -> Path:
    """Write a photo whose notes say this focal length in terms of 35-mm film; None writes no notes."""
    exif = Image.Exif()
    if film_focal is not None:
        exif[0x0112] = 1  # without a tag of its own, Pillow leaves the directory out
        exif.get_ifd(0x8769)[0xA405] = film_focal
    Image.fromarray(smooth(size)).save(path, exif=exif)
    return path


def film_camera(film_focal: float, size: tuple[int, int]) -> Camera:
    return Camera.from_focal(film_focal / math.hypot(36, 24) * math.hypot(*size), size, source="exif")


@pytest.mark.parametrize(
    ("camera", "canonical", "wanted", "corrected"),
    [
        ("exif", True, None, True),
        ("exif", False, None, False),
        ("exif", False, True, True),
        ("exif", True, False, False),
        ("given", True, None, True),
        ("given", False, None, True),
        ("given", False, False, False),
        ("none", True, None, False),
        ("none", False, False, False),
    ],
)
def test_depth_is_corrected_where_the_camera_is_given_or_the_model_has_one_camera(
    tmp_path: Path, camera: str, canonical: bool, wanted: bool | None, corrected: bool
) -> None:
    """Twice the focal length, twice the depth, and twice the standard deviation. Nobody's camera corrects nothing."""
    path = taken_with(tmp_path / "photo.jpg", 50)
    given = Camera.from_focal(123.0, (64, 96))
    model = Brightness(canonical=canonical, focal_px=FOCAL_PX)
    choice = given if camera == "given" else camera
    result = Predictor(model, pad=False, camera=choice, focal_correction=wanted)(path, domain="indoor")
    plain = Predictor(Brightness(), pad=False, camera="none")(path, domain="indoor")
    truth = {
        "exif": film_camera(50, (64, 96)),
        "given": given,
        "none": Camera.from_focal(FOCAL_PX, (64, 96), source="assumed"),
    }
    assert result.camera == truth[camera]
    factor = truth[camera].fx / FOCAL_PX if corrected else 1.0  # the network sees the photo as it is
    assert result.focal_correction == pytest.approx(factor, rel=1e-9)
    np.testing.assert_allclose(result.depth, plain.depth * factor, rtol=1e-6)
    np.testing.assert_allclose(result.std, plain.std * factor, rtol=1e-6)
    assert result.depth_range == pytest.approx((1e-3 * factor, 10 * factor))
    if not corrected:
        np.testing.assert_array_equal(result.depth, plain.depth)


def test_each_domain_has_its_own_factor_on_the_standard_deviation() -> None:
    model = Brightness(focal_px=FOCAL_PX)
    model.config.domains = tuple(
        replace(domain, std_factor=factor) for domain, factor in zip(model.config.domains, (1.5, 3.0), strict=True)
    )
    photo, camera = smooth((64, 96)), Camera.from_focal(2 * FOCAL_PX, (64, 96))
    for domain, factor in (("indoor", 1.5), ("outdoor", 3.0)):
        plain = Predictor(Brightness(), pad=False)(photo, domain=domain)
        result = Predictor(model, pad=False, camera=camera)(photo, domain=domain)
        np.testing.assert_allclose(result.depth, 2 * plain.depth, rtol=1e-6)
        np.testing.assert_allclose(result.std, 2 * factor * plain.std, rtol=1e-6)


@pytest.mark.parametrize("pad", [True, False])
@pytest.mark.parametrize("size", [(128, 192), (97, 131), (200, 150), (24, 120)])
def test_the_assumed_camera_is_that_of_the_training_photos(size: tuple[int, int], pad: bool) -> None:
    """Said to be given, it would correct nothing."""
    predictor = Predictor(Brightness(focal_px=FOCAL_PX), pad=pad)
    assumed = predictor(smooth(size)).camera
    assert (assumed.source, assumed.size) == ("assumed", size)
    assert predictor(smooth(size), camera=assumed.intrinsics).focal_correction == pytest.approx(1)
    assert predictor(smooth(size), camera=assumed).focal_correction == 1
    nothing_known = Predictor(Brightness())(smooth(size)).camera
    assert nothing_known.source == "assumed"
    assert nothing_known.fov_x == pytest.approx(60)


def test_padding_makes_the_focal_length_shorter() -> None:
    """The network sees a padded photo at a smaller scale."""
    photo, camera = smooth((64, 96)), Camera.from_focal(100.0, (64, 96))
    model = Brightness(focal_px=FOCAL_PX)
    padded = Predictor(model, pad=True)(photo, camera=camera).focal_correction
    expected = 100 / FOCAL_PX * 64 / (64 + 2 * 16)  # 3 sqrt(64 / 2)
    assert padded == pytest.approx(expected)


def test_given_intrinsics_come_back_to_the_last_bit() -> None:
    intrinsics = Intrinsics(0.1 + 0.2 + 90, 100 / 3, 47.000000000000014, 31.1)
    result = Predictor(Brightness(focal_px=FOCAL_PX))(smooth((64, 96)), camera=intrinsics)
    assert result.camera.intrinsics == intrinsics
    assert result.camera.source == "given"
    assert result.intrinsics.tolist() == [
        [intrinsics.fx, 0, intrinsics.cx],
        [0, intrinsics.fy, intrinsics.cy],
        [0, 0, 1],
    ]


def test_a_camera_for_each_photo_or_one_for_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """None is that of the predictor, which asks the notes here."""
    path = taken_with(tmp_path / "photo.jpg", 35)
    photos = [path, path, smooth((64, 96)), smooth((50, 70))]
    cameras = [Lens(fov_x=50), None, None, Intrinsics(70.0, 71.0, 30.0, 20.0)]
    for together in (False, True):
        monkeypatch.setattr(TensorForward, "_one_by_one", not together)
        predictor = Predictor(Brightness(focal_px=FOCAL_PX, canonical=True))
        results = predictor.batch(photos, camera=cameras, batch_size=3)
        assert [result.camera.source for result in results] == ["given", "exif", "assumed", "given"]
        for photo, camera, result in zip(photos, cameras, results, strict=True):
            assert_same(result, predictor(photo, camera=camera), atol=1e-5)
            assert result.camera == predictor(photo, camera=camera).camera
        assert {result.camera.fov_x for result in predictor.batch(photos[:3], camera=Lens(fov_x=50))} == {
            results[0].camera.fov_x
        }
    with pytest.raises(InputError, match="4 photos and 3 cameras"):
        predictor.batch(photos, camera=cameras[:3])


def test_a_predictor_s_camera_may_be_of_another_size_but_not_of_other_proportions() -> None:
    camera = Camera((480, 720), 600.0, 601.0, 350.0, 250.0)
    predictor = Predictor(Brightness(focal_px=FOCAL_PX), camera=camera)
    assert predictor(smooth((64, 96))).camera == camera.resized((64, 96))
    with pytest.raises(InputError, match="of photos of 720 x 480 pixels, and the photo has 90 x 64"):
        predictor(smooth((64, 90)))
    assert predictor(smooth((64, 90)), camera="none").camera.source == "assumed"


@pytest.mark.parametrize(
    ("film_focal", "note"), [(None, "no EXIF"), (0, "nonsense"), (65535, "nonsense"), ("telephoto", "nonsense")]
)
def test_notes_that_tell_no_camera_leave_the_assumed_one_and_the_reason(
    tmp_path: Path, film_focal: object, note: str
) -> None:
    path = taken_with(tmp_path / "photo.png", film_focal)
    result = Predictor(Brightness(focal_px=FOCAL_PX, canonical=True))(path)
    assert (result.camera.source, result.focal_correction) == ("assumed", 1)
    assert note in result.camera_note
    assert Predictor(Brightness(), camera="none")(path).camera_note == ""


def test_damaged_notes_are_no_reason_not_to_predict(tmp_path: Path) -> None:
    path = taken_with(tmp_path / "photo.jpg", 35)
    content = path.read_bytes()
    start = content.index(b"Exif\0\0")
    path.write_bytes(content[: start + 10] + b"\xff" * 12 + content[start + 22 :])
    assert Predictor(Brightness(focal_px=FOCAL_PX, canonical=True))(path).camera.source == "assumed"


def test_notes_are_read_from_files_streams_and_pil_images(tmp_path: Path) -> None:
    path = taken_with(tmp_path / "photo.jpg", 35)

    class Pipe(io.BytesIO):
        def seekable(self) -> bool:
            return False

    predictor = Predictor(Brightness())
    with Image.open(path) as picture, path.open("rb") as file:
        for source in (path, str(path), file, Pipe(path.read_bytes()), picture):
            assert predictor(source).camera == film_camera(35, (64, 96))


def test_infer_corrects_each_photo_by_its_own_camera(tiny_config: ModelConfig) -> None:
    """As a call does; gradients are scaled, too."""
    domains = tuple(replace(domain, focal_px=FOCAL_PX) for domain in tiny_config.domains)
    model = ZoeDepth(replace(tiny_config, domains=domains)).eval()
    photos = [smooth((50, 70), seed) for seed in range(3)]
    pixels = torch.stack([torch.from_numpy(photo).permute(2, 0, 1) for photo in photos]) / 255
    cameras = [Lens(fov_x=40), "none", Intrinsics(60.0, 60.0, 35.0, 25.0)]
    predictor = Predictor(model)
    depth = predictor.infer(pixels, camera=cameras).detach()
    for row, (photo, camera) in enumerate(zip(photos, cameras, strict=True)):
        np.testing.assert_allclose(depth[row, 0], predictor(photo, camera=camera).depth, rtol=1e-4)
    pixels.requires_grad_()
    (plain,) = torch.autograd.grad(predictor.infer(pixels).sum(), pixels)
    (scaled,) = torch.autograd.grad(predictor.infer(pixels, camera=Intrinsics(160.0, 160.0, 35.0, 25.0)).sum(), pixels)
    factor = predictor(photos[0], camera=Intrinsics(160.0, 160.0, 35.0, 25.0)).focal_correction
    torch.testing.assert_close(scaled, plain * factor, rtol=1e-4, atol=1e-6)
    with pytest.raises(InputError, match="3 photos and 2 cameras"):
        predictor.infer(pixels, camera=cameras[:2])
    with pytest.raises(InputError, match="of photos of 100 x 100 pixels"):
        predictor.infer(pixels, camera=Camera.from_focal(50.0, (100, 100)))


def test_what_cannot_be_a_camera_is_refused(unchecked_types: None) -> None:
    for wrong in ("exiv", 70, np.eye(3), object()):
        with pytest.raises(InputError, match="camera must be a Camera, Intrinsics, a Lens, 'exif' or 'none'"):
            Predictor(Brightness(), camera=wrong)
        with pytest.raises(InputError, match="camera must be a Camera"):
            Predictor(Brightness())(smooth((64, 96)), camera=wrong)
    for wrong in (0.0, -500.0, math.nan, math.inf):
        with pytest.raises(InputError, match="focal length"):
            Predictor(Brightness())(smooth((64, 96)), camera=Intrinsics(wrong, 500.0, 40.0, 30.0))
    with pytest.raises(InputError, match="principal point"):
        Predictor(Brightness())(smooth((64, 96)), camera=Intrinsics(500.0, 500.0, math.nan, 30.0))


def test_intrinsics_of_photos_of_another_size_are_refused() -> None:
    with pytest.raises(InputError, match=r"far from the middle of a photo of 96 x 64 pixels.*Scale them"):
        Predictor(Brightness())(smooth((64, 96)), camera=Intrinsics(30, 30, 11.5, 7.5))


def test_a_correction_without_a_camera_is_refused() -> None:
    with pytest.raises(InputError, match=r"names no focal length to correct depth by"):
        Predictor(Brightness(), camera="none", focal_correction=True)


def test_a_model_of_unknown_focal_length_is_not_corrected_and_says_so_where_it_is_asked_to() -> None:
    assert Predictor(Brightness())(smooth((64, 96)), camera=Lens(fov_x=20)).focal_correction == 1
    with pytest.raises(
        InputError, match=r"not say with what focal length.*indoor, outdoor.*leave focal_correction out"
    ):
        Predictor(Brightness(), focal_correction=True)


# ------------------------------------------------------------------------------------------------------ relative depth


def test_relative_depth_has_the_photo_s_size_no_sign_and_a_mirror_image(tiny_model: ZoeDepth) -> None:
    photo = smooth((70, 90))
    relative = Predictor(tiny_model).relative(photo)
    assert relative.shape == (70, 90)
    assert relative.dtype == np.float32
    assert relative.min() >= 0
    assert relative.std() > 0
    mirrored = Predictor(tiny_model).relative(photo[:, ::-1])
    np.testing.assert_allclose(mirrored[:, ::-1], relative, rtol=1e-3, atol=1e-5)


def test_relative_depth_needs_no_metric_head(tiny_model: ZoeDepth) -> None:
    config = dataclasses.replace(tiny_model.config, domains=())
    bare = ZoeDepth(config).eval()
    bare.load_state_dict({k: v for k, v in tiny_model.state_dict().items() if k.startswith(("encoder", "decoder"))})
    photo = smooth((70, 90))
    assert np.array_equal(Predictor(bare).relative(photo), Predictor(tiny_model).relative(photo))
    with pytest.raises(InputError, match="relative depth only"):
        Predictor(bare)(photo)


# ------------------------------------------------------------------------------------------------ options and refusals


def test_model_is_left_as_it_was(tiny_model: ZoeDepth) -> None:
    before = copy.deepcopy(tiny_model.state_dict())
    result = Predictor(tiny_model)(smooth((40, 60)))
    assert not tiny_model.training
    assert all(parameter.requires_grad and parameter.grad is None for parameter in tiny_model.parameters())
    assert all(torch.equal(before[name], value) for name, value in tiny_model.state_dict().items())
    assert result.depth.flags.writeable


def test_options(tiny_model: ZoeDepth) -> None:
    photo = smooth((40, 60))
    full = Predictor(tiny_model, device="cpu")(photo)
    reduced = Predictor(tiny_model, precision="bfloat16")(photo)
    assert reduced.depth.dtype == np.float32
    np.testing.assert_allclose(reduced.depth, full.depth, rtol=0.1)
    with pytest.raises((InputError, TypeError), match="precision"):  # TypeError: where types are checked at run time
        Predictor(tiny_model, precision="int4")
    with pytest.raises((InputError, TypeError), match="resize"):
        Predictor(tiny_model, resize="crop")
    with pytest.raises(InputError, match="'abacus'"):
        Predictor(tiny_model, device="abacus")


def test_training_mode_is_refused(tiny_model: ZoeDepth) -> None:
    predictor, photo = Predictor(tiny_model.train()), smooth((40, 60))
    for call in (
        lambda: predictor(photo),
        lambda: predictor.relative(photo),
        lambda: predictor.infer(torch.rand(1, 3, 8, 8)),
    ):
        with pytest.raises(InputError, match=r"training mode.*model\.eval\(\)"):
            call()


@pytest.mark.parametrize(
    "pixels",
    [
        torch.rand(3, 8, 8),
        torch.rand(1, 4, 8, 8),
        torch.zeros(1, 3, 8, 8, dtype=torch.uint8),
        torch.rand(1, 3, 0, 8),
    ],
)
def test_wrong_tensors(tiny_model: ZoeDepth, pixels: Tensor, unchecked_types: None) -> None:
    with pytest.raises(InputError, match="pixels must be float"):
        Predictor(tiny_model).infer(pixels)
