"""Whose file is it? Names do not tell."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.images import PICTURE_SUFFIXES, write_image
from zoedepth.outputs import OUTPUTS, Maps, Options
from zoedepth.outputs.ownership import has_own_mark, is_own_file, require_own_mark
from zoedepth.outputs.sidecar import write_sidecar

RAMP = np.linspace(1, 5, 12, dtype=np.float32).reshape(3, 4)
CAMERA = Camera.from_focal(4.0, (3, 4))
MAPS = Maps(depth=RAMP, relative=1 / RAMP, image=np.full((3, 4, 3), 200, np.uint8), camera=CAMERA)
SIDECAR = {"zoedepth": "0.1.0", "source": "a.jpg"}


def test_files_and_links_of_others_are_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    require_own_mark(path, advice="move it")
    write_image(path, np.zeros((8, 8, 3), np.uint8))
    require_own_mark(path, advice="move it")
    path.write_text("mine")
    (tmp_path / "link.jpg").symlink_to(tmp_path / "nowhere.jpg")
    for theirs in (path, tmp_path / "link.jpg"):
        with pytest.raises(InputError, match=rf"{theirs.name} is not from zoedepth, and would be replaced: move it"):
            require_own_mark(theirs, advice="move it")


@pytest.mark.parametrize("name", sorted(OUTPUTS.keys() - {"npy", "npz", "pfm"}))
def test_most_files_are_known_by_their_content_alone(tmp_path: Path, name: str) -> None:
    if name == "exr":
        pytest.importorskip("OpenEXR")
    path = tmp_path / f"renamed{Path(OUTPUTS[name].ending).suffix}"
    OUTPUTS[name].write(path, MAPS, Options())
    assert has_own_mark(path)
    assert is_own_file(path)


@pytest.mark.parametrize("suffix", PICTURE_SUFFIXES)
def test_every_picture_that_shows_something_about_photos_is_ours(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(0)
    write_image(tmp_path / f"sheet{suffix}", rng.integers(0, 256, (200, 300, 3), dtype=np.uint8))
    assert is_own_file(tmp_path / f"sheet{suffix}")


@pytest.mark.parametrize("name", ["npy", "npz", "pfm"])
def test_arrays_are_known_by_the_sidecar_that_lists_them(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"my_photo{OUTPUTS[name].ending}"
    OUTPUTS[name].write(path, MAPS, Options())
    assert not is_own_file(path)
    for listing in ({"files": {name: path.name}}, {"files": {}, "other_files": [path.name]}):
        write_sidecar(tmp_path / "my_photo.json", {**SIDECAR, **listing})
        assert is_own_file(path)
    write_sidecar(tmp_path / "my_photo.json", {**SIDECAR, "files": {"depth": "my_photo_depth.png"}})
    assert not is_own_file(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".tif"])
def test_photos_are_not_ours(tmp_path: Path, suffix: str) -> None:
    """Also where a sidecar of theirs is beside them."""
    write_sidecar(tmp_path / "a.json", {**SIDECAR, "files": {"depth": "a_depth.png"}})
    Image.new("RGB", (4, 3)).save(tmp_path / f"a{suffix}")
    assert not is_own_file(tmp_path / f"a{suffix}")


@pytest.mark.parametrize(
    ("content", "own"),
    [
        (json.dumps({**SIDECAR, "files": {"depth": "a_depth.png"}}), True),
        (json.dumps({**SIDECAR, "files": ["a_depth.png"]}), False),
        (json.dumps({"source": "a.jpg", "files": {}}), False),
        (json.dumps({**SIDECAR, "files": {"depth": 1}}), False),
        ('{"shapes": []}', False),
        ("[]", False),
        ("", False),
        (" " * 100_000, False),
    ],
)
def test_sidecars_are_known_by_what_they_hold(tmp_path: Path, content: str, own: bool) -> None:
    (tmp_path / "a.json").write_text(content)
    assert is_own_file(tmp_path / "a.json") is own


def test_what_is_no_file_is_not_ours(tmp_path: Path) -> None:
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "short.webp").write_bytes(b"RIFF")
    for name in ("folder.json", "short.webp", "missing.png", "missing.npy"):
        assert not is_own_file(tmp_path / name)
