import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("embreex")

from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.synthetic import SyntheticScenes

SIZE = (48, 64)
ROOT = Path(__file__).parents[2]
DIGEST = """
from tests.synthetic.test_dataset import digest
from zoedepth.synthetic import SyntheticScenes
data = SyntheticScenes(8, size=(48, 64), seed=1)
print(*(digest(data[i]) for i in (3, 2)))
"""


def digest(sample: Sample) -> str:
    """Hash all that a sample holds."""
    tensors = sample.image.numpy().tobytes() + sample.target.numpy().tobytes() + sample.mask.numpy().tobytes()
    return hashlib.sha256(tensors + repr((sample.camera, sample.name, sample.domain)).encode()).hexdigest()


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    data = SyntheticScenes(30, size=SIZE, seed=1)
    return [data[i] for i in range(len(data))]


def depths(samples: list[Sample], domain: str) -> list[np.ndarray]:
    """The known depths of each sample of a domain."""
    return [s.target[s.mask].numpy() for s in samples if s.domain == domain]


def test_sample_is_like_that_of_any_data_set(samples: list[Sample]) -> None:
    for i, sample in enumerate(samples):
        assert sample.image.shape == (3, *SIZE)
        assert sample.image.dtype == torch.float32
        assert 0 <= sample.image.min() < sample.image.max() <= 1
        assert sample.target.shape == sample.mask.shape == (1, *SIZE)
        assert sample.mask.dtype == torch.bool
        assert torch.isfinite(sample.target).all()
        assert torch.equal(sample.mask, sample.target > 0)
        assert sample.kind == "depth"
        assert sample.domain == ("indoor", "outdoor")[i % 2]
        assert sample.camera is not None
        assert 40 < np.rad2deg(2 * np.arctan(SIZE[1] / 2 / sample.camera.fx)) < 95
    assert len({sample.name for sample in samples}) == len(samples)


def test_same_bits_again_in_any_order_and_in_another_process(samples: list[Sample]) -> None:
    expected = [digest(samples[i]) for i in (3, 2)]
    again = SyntheticScenes(100, size=SIZE, seed=1)
    assert [digest(again[i]) for i in (3, 2)] == expected
    command = [sys.executable, "-c", DIGEST]
    other = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert other.stdout.split() == expected


def test_workers_forked_after_a_rendering_give_the_same(samples: list[Sample]) -> None:
    data = SyntheticScenes(2, size=SIZE, seed=1)
    loader = torch.utils.data.DataLoader(data, batch_size=None, num_workers=1, multiprocessing_context="fork")
    assert [digest(sample) for sample in loader] == [digest(sample) for sample in samples[:2]]


def test_seed_and_index_make_another_scene(samples: list[Sample]) -> None:
    other = SyntheticScenes(2, size=SIZE, seed=2)[0]
    assert digest(other) != digest(samples[0])
    assert len({digest(sample) for sample in samples}) == len(samples)


def test_depths_vary_and_are_those_of_rooms_and_streets(samples: list[Sample]) -> None:
    for domain, low, high, factor in (("indoor", 0.8, 9.0, 1.8), ("outdoor", 3.5, 60.0, 2.0)):
        medians = [float(np.median(d)) for d in depths(samples, domain)]
        assert low < min(medians) < max(medians) < high
        assert max(medians) > factor * min(medians)
    assert max(d.max() for d in depths(samples, "indoor")) < 18
    assert np.median([d.max() for d in depths(samples, "outdoor")]) > 80


def test_no_picture_is_of_the_inside_of_a_thing_or_mostly_unknown(samples: list[Sample]) -> None:
    for sample in samples:
        known = sample.target[sample.mask]
        assert (known < 0.3).float().mean() < 0.05
        assert sample.mask.float().mean() > 0.3
        assert sample.image.std() > 0.03
    assert np.mean([s.mask.float().mean() for s in samples if s.domain == "indoor"]) > 0.85


def test_camera_and_depth_agree_on_flat_ground(samples: list[Sample]) -> None:
    """Points of a level floor, put back with the camera, lie in a plane: depth is along the axis, not along the ray."""
    residuals = []
    for sample in (s for s in samples if s.domain == "indoor" and s.camera is not None):
        assert sample.camera is not None
        points = sample.camera.rays(SIZE) * sample.target[0].numpy()[..., None]
        floor = points[-12:][sample.mask[0, -12:].numpy()].astype(float)
        best = 1.0
        rng = np.random.default_rng(0)
        for _ in range(40):  # planes through three points: the floor or a wall fits one of them
            a, b, c = floor[rng.choice(len(floor), 3, replace=False)]
            normal = np.cross(b - a, c - a)
            if np.linalg.norm(normal) > 1e-3:
                away = np.abs((floor - a) @ normal) / np.linalg.norm(normal)
                best = min(best, float(np.quantile(away, 0.25)))
        residuals.append(best)
    assert np.median(residuals) < 1e-4


def test_domains_can_be_chosen() -> None:
    data = SyntheticScenes(3, size=(32, 48), domains=["outdoor"])
    assert data.domains == ["outdoor"]
    assert data.kinds == ["depth"]
    assert data[1].domain == "outdoor"
    assert SyntheticScenes(10).domains == ["indoor", "outdoor"]


def test_lenses_are_drawn_between_two_fields_of_view() -> None:
    """Log-uniform focal lengths: as many above as below the geometric mean, here 2 atan(sqrt(tan 17.5 tan 50))."""
    data = SyntheticScenes(9, size=(32, 48), seed=2, fields_of_view=(35, 100))
    fields = [2 * np.rad2deg(np.arctan(24 / data[i].camera.fx)) for i in range(len(data))]
    assert all(35 <= field <= 100 for field in fields)
    assert 2 <= sum(field < 63 for field in fields) <= 7
    one = SyntheticScenes(1, size=(32, 48), fields_of_view=(70, 70))[0]
    assert 2 * np.rad2deg(np.arctan(24 / one.camera.fx)) == pytest.approx(70)


def test_what_cannot_be_rendered_is_refused() -> None:
    with pytest.raises(InputError, match=r"moon.*indoor.*outdoor"):
        SyntheticScenes(3, domains=["moon"])
    with pytest.raises(InputError, match="domains"):
        SyntheticScenes(3, domains=[])
    for options in ({"size": (8, 8)}, {"size": (31, 64)}, {"n": 0}, {"seed": -1}):
        with pytest.raises(InputError, match="32 pixels"):
            SyntheticScenes(**options)
    for fields_of_view in ((0, 60), (60, 50), (60, 140), (float("nan"), 60)):
        with pytest.raises(InputError, match="fields of view must be two numbers from 10 to 130 degrees"):
            SyntheticScenes(3, fields_of_view=fields_of_view)
    for index in (3, -1):
        with pytest.raises(IndexError):
            SyntheticScenes(3)[index]
