from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.serve.running import read_maps

from zoedepth.depth_map import DepthMap
from zoedepth.geometry.camera import Camera
from zoedepth.outputs import OUTPUTS, Options
from zoedepth.serve.answers import FORMATS, NAMES, about, choose_format, encode, remove_drafts
from zoedepth.serve.photos import Decoded
from zoedepth.serve.problems import Problem


def depth_map(height: int, width: int, *, std: bool = True) -> DepthMap:
    depth = np.random.default_rng(0).uniform(1, 5, (height, width)).astype(np.float32)
    image = np.zeros((height, width, 3), np.uint8)
    camera = Camera.from_focal(100, (height, width))
    return DepthMap(depth, depth / 9 if std else None, "indoor", {"indoor": 1.0}, image, (64, 64), camera)


PHOTO = Decoded(np.zeros((1, 1, 3), np.uint8), "none", "", ("it is dark",))


def test_every_output_of_metres_is_a_format() -> None:
    of_depth = {name for name, output in OUTPUTS.items() if "depth" in output.maps}
    assert set(FORMATS) == of_depth | {"json", "maps"}
    assert len(set(NAMES)) == len(NAMES)
    assert {"png", "jpg", "exr", "npz", "ply", "glb", "json"} <= set(NAMES)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 5), (7, 9), (8, 16)])
@pytest.mark.parametrize("std", [True, False])
def test_maps_of_any_size_are_aligned_and_whole(height: int, width: int, std: bool) -> None:
    result = depth_map(height, width, std=std)
    header, arrays = read_maps(encode(result, PHOTO, FORMATS["maps"], Options(), model="m").content)
    assert ("std" in arrays) is std
    assert np.array_equal(arrays["depth"], result.depth)
    assert np.array_equal(arrays["valid"], result.valid)
    assert header["notes"] == ["it is dark"]


def test_no_file_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoedepth.serve.answers.memory_folder", lambda: str(tmp_path))
    encode(depth_map(3, 5), PHOTO, FORMATS["depth"], Options(), model="m")
    broken = depth_map(3, 5)
    object.__setattr__(broken, "maps", _Full(tmp_path))
    with pytest.raises(OSError, match="full"):
        encode(broken, PHOTO, FORMATS["depth"], Options(), model="m")
    assert list(tmp_path.iterdir()) == []


def test_what_was_begun_is_removed_before_the_process_ends_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zoedepth.serve.answers.memory_folder", lambda: str(tmp_path))
    (tmp_path / "zoedepth-1-another").mkdir()  # of another process
    seen: list[str] = []

    def end(path: Path, *_: object) -> None:
        path.write_text("half a photo")
        seen.append(path.parent.name)
        remove_drafts()
        assert not path.parent.exists()
        raise SystemExit

    monkeypatch.setitem(OUTPUTS, "depth", replace(OUTPUTS["depth"], write=end))
    with pytest.raises(SystemExit):
        encode(depth_map(3, 5), PHOTO, FORMATS["depth"], Options(), model="m")
    assert len(seen) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["zoedepth-1-another"]


class _Full:
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def up_to(self, metres: float | None) -> "_Full":
        return self

    @property
    def depth(self) -> None:
        assert list(self._folder.iterdir()) != []  # it is written here
        raise OSError(28, "full")


def test_a_range_without_an_end_is_told_as_none() -> None:
    told = about(depth_map(2, 2), PHOTO, model="m", facts={})
    assert told["depth_range"] == (0.0, None)


def test_the_most_wanted_format_is_chosen_first() -> None:
    assert choose_format("jpg", "application/json").name == "preview"
    assert choose_format(None, "application/json;q=0.2, image/tiff;q=0.9").name == "tiff"
    assert choose_format(None, "image/webp, image/*").name == "depth"
    for accept in ("application/json;q=0", "text/csv;q=x"):
        with pytest.raises(Problem, match="Accept names no format") as caught:
            choose_format(None, accept)
        assert caught.value.kind == "not-acceptable"
