"""Models side by side: what is in which panel, and in which colours."""

import numpy as np
import pytest
from tests.evaluation.samples import FactorSource, photo, sample_of

from zoedepth.colors import INVALID_COLOR, colorize
from zoedepth.evaluation import comparison
from zoedepth.evaluation.comparison import compared
from zoedepth.evaluation.protocols import Protocol

PROTOCOLS = {"indoor": Protocol("near", max_depth=6.0)}


@pytest.fixture
def panels(monkeypatch: pytest.MonkeyPatch) -> dict[str, np.ndarray]:
    """Caption → picture of every panel that is drawn."""
    found: dict[str, np.ndarray] = {}
    draw = comparison.panel

    def panel(image: np.ndarray, *, caption: str = "", **rest: object) -> np.ndarray:
        found[caption] = image
        return draw(image, caption=caption, **rest)

    monkeypatch.setattr(comparison, "panel", panel)
    return found


def test_row_has_photo_truth_depths_and_squared_errors(panels: dict[str, np.ndarray]) -> None:
    truth = np.full((40, 60), 2.0)
    truth[:, 30:] = 4.0
    truth[:10] = 0.0  # unknown
    truth[10:20] = 8.0  # beyond what is scored
    sources = {"good": FactorSource({}), "bad": FactorSource({"photo.jpg": 1.5})}
    sheet = compared(sources, [sample_of(truth)], [0], PROTOCOLS)
    assert list(panels) == ["photo.jpg", "measured", "good", "bad", "good: squared error", "bad: squared error"]
    assert sheet.shape[1] > 6 * 280
    good, bad, measured = (panels[name] for name in ("good: squared error", "bad: squared error", "measured"))
    size = good.shape[0]
    assert (good[: size // 2 - 1] == INVALID_COLOR).all()  # unknown, or not scored
    assert (measured[: size // 4 - 1] == INVALID_COLOR).all()
    assert not (measured[size // 4 + 1 :] == INVALID_COLOR).all(axis=2).any()
    blue, red = colorize(np.array([[1.0, 2.0]]), vmin=1, vmax=2, colormap="turbo")[0]
    assert (good[size // 2 + 1 :] == blue).all()
    # 1.5 times 2 m is 1 m off, 1.5 times 4 m is 2 m off: 1 and 4 square metres, on one scale.
    assert (bad[-1, -1] == red).all()
    assert (bad[-1, 0] != red).any()
    assert (bad[-1, 0] != blue).any()


def test_every_photo_has_a_row_and_wide_ones_two_lines(panels: dict[str, np.ndarray]) -> None:
    narrow = [photo((40, 60), seed=i, name=f"{i}.jpg") for i in range(3)]
    one, two = (compared({"a": FactorSource({})}, narrow, indices, PROTOCOLS) for indices in ([1], [0, 2]))
    assert {"0.jpg", "1.jpg", "2.jpg"} <= set(panels)
    assert two.shape[0] > 1.9 * one.shape[0]
    assert two.shape[1] >= one.shape[1]
    wide = compared({"a": FactorSource({})}, [photo((30, 90), name="wide.jpg")], [0], PROTOCOLS)
    assert wide.shape[1] > 3 * 480
    assert wide.shape[0] > 2 * 160
