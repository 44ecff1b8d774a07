"""Pictures of depth and of relative depth."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.colors import preview, preview_relative
from zoedepth.errors import InputError
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.preview import PREVIEW

RAMP = np.tile(np.linspace(1, 5, 60, dtype=np.float32), (40, 1))
IMAGE = np.full((40, 60, 3), 200, np.uint8)


@pytest.mark.parametrize(
    ("maps", "options", "expected"),
    [
        (
            Maps(depth=RAMP, image=IMAGE),
            Options(vmin=2.0, vmax=3.0, colormap="gray"),
            preview(IMAGE, RAMP, vmin=2.0, vmax=3.0, colormap="gray"),
        ),
        (Maps(relative=RAMP, image=IMAGE), Options(), preview_relative(IMAGE, RAMP)),
    ],
    ids=["depth", "relative"],
)
def test_is_the_picture_with_the_asked_colours(
    tmp_path: Path, maps: Maps, options: Options, expected: np.ndarray
) -> None:
    PREVIEW.write(tmp_path / "preview.jpg", maps, options)
    with Image.open(tmp_path / "preview.jpg") as picture:
        found = np.asarray(picture).astype(float)
    assert found.shape == expected.shape
    assert abs(found - expected).mean() < 3  # JPEG


def test_needs_the_photo(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'image'"):
        PREVIEW.write(tmp_path / "preview.jpg", Maps(depth=RAMP), Options())
