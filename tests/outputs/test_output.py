"""Rules for every kind of file. A new kind is in ``OUTPUTS`` and inherits these tests."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.outputs import OUTPUTS, Maps, Options, Output, write_maps

RAMP = np.linspace(1, 5, 12, dtype=np.float32).reshape(3, 4)
IMAGE = np.full((3, 4, 3), 200, np.uint8)
ALL = {"depth": RAMP, "relative": 1 / RAMP}


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("output", OUTPUTS.values(), ids=OUTPUTS)
class TestEveryOutput:
    def test_writes_one_file_of_each_map_it_can_be_made_of(self, output: Output, tmp_path: Path) -> None:
        for name in output.maps:
            path = tmp_path / name / f"photo{output.ending}"
            output.write(path, Maps(**{name: ALL[name]}, image=IMAGE), Options())
            assert files(path.parent) == [path.name]
            assert path.stat().st_size > 0

    def test_refuses_what_it_cannot_be_made_of_and_leaves_nothing(self, output: Output, tmp_path: Path) -> None:
        for name in ALL.keys() - set(output.maps) | {None}:
            maps = Maps(**({name: ALL[name]} if name else {}), image=IMAGE)
            with pytest.raises(InputError):
                output.write(tmp_path / f"photo{output.ending}", maps, Options())
        assert files(tmp_path) == []

    def test_has_an_ending_and_suffixes_of_its_own(self, output: Output) -> None:
        assert Path(f"photo{output.ending}").suffix
        assert output.summary
        others = [other for other in OUTPUTS.values() if other is not output]
        assert not any(other.ending.endswith(output.ending) for other in others)
        assert not set(output.suffixes) & {suffix for other in others for suffix in other.suffixes}
        assert all(suffix.startswith(".") and suffix == suffix.lower() for suffix in output.suffixes)


def test_the_suffix_chooses_the_output(tmp_path: Path) -> None:
    maps = Maps(depth=RAMP, image=IMAGE)
    for output in OUTPUTS.values():
        for suffix in output.suffixes:
            output.write(tmp_path / f"expected{suffix}", maps, Options())
            write_maps(tmp_path / f"found{suffix.upper()}", maps)
            found, expected = tmp_path / f"found{suffix.upper()}", tmp_path / f"expected{suffix}"
            assert found.read_bytes() == expected.read_bytes()
    with pytest.raises(InputError, match=r"depth\.tiff.*\.png, .*\.npz"):
        write_maps(tmp_path / "depth.tiff", maps)


def test_maps_must_fit_together() -> None:
    for wrong in ({"depth": RAMP[None]}, {"depth": np.zeros((0, 4), np.float32)}, {"std": IMAGE}):
        with pytest.raises((InputError, TypeError), match=r"height, width|std"):  # TypeError: types checked at run time
            Maps(**wrong)
    with pytest.raises(InputError, match="one size"):
        Maps(depth=RAMP, image=IMAGE[:2])


def test_confidence_is_that_of_the_standard_deviation() -> None:
    np.testing.assert_allclose(Maps(depth=RAMP, std=RAMP).confidence, 0.5)
    assert Maps(depth=RAMP).confidence is None


@pytest.mark.parametrize(
    "options", [{"png_scale": 0.0}, {"png_scale": np.nan}, {"vmin": 5.0, "vmax": 1.0}, {"colormap": "jet"}]
)
def test_wrong_options_are_found_before_anything_is_written(options: dict) -> None:
    with pytest.raises(InputError, match=r"scale|vmin|jet"):
        Options(**options)
