"""Bounds on what a file hands out, and on the maps it may hold."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.images import MAX_PIXELS
from zoedepth.stored import BoundedFile, Memory, read_depth
from zoedepth.stored.files import check_map


def test_bounded_file_gives_what_is_asked_for_up_to_its_bound() -> None:
    file = BoundedFile(BytesIO(b"0123456789"), max_bytes=4)
    assert (file.read(4), file.read(2), file.read(), file.read(1)) == (b"0123", b"45", b"6789", b"")
    file.seek(0)
    for size in (5, -1):
        with pytest.raises(ValueError, match="more than 4 bytes"):
            file.read(size)


def test_file_in_memory_says_its_name() -> None:
    file = Memory(b"12", "a.tar, sample 3", ".png")
    assert (str(file), file.suffix, file.read()) == ("a.tar, sample 3", ".png", b"12")


@pytest.mark.parametrize(
    ("shape", "dtype", "word"),
    [
        ((3,), "f4", "one map"),
        ((2, 3, 1), "f4", "one map"),
        ((0, 3), "f4", "one map"),
        ((-1, 5), "f4", "one map"),
        ((2, 3), "S1", "one map"),
        ((MAX_PIXELS, 2), "u1", "more than"),
        ((MAX_PIXELS // 2 + 1, 1), "f8", "more than"),
    ],
)
def test_what_is_no_map_is_refused(shape: tuple[int, ...], dtype: str, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        check_map(shape, np.dtype(dtype))


def test_the_largest_maps_pass() -> None:
    check_map((MAX_PIXELS, 1), np.dtype("f4"))
    check_map((MAX_PIXELS // 2, 1), np.dtype("f8"))


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".pfm", ".pgm", ".png", ".tif", ".exr"])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n", "Git LFS keeps.*git lfs pull"),
        (b"\n<!DOCTYPE html>\n<html>Sign in", "it is a web page"),
        (b"", "it is empty"),
    ],
    ids=["Git LFS", "web page", "empty"],
)
def test_what_stands_in_place_of_a_map_is_named(tmp_path: Path, suffix: str, content: bytes, message: str) -> None:
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    (tmp_path / f"depth{suffix}").write_bytes(content)
    with pytest.raises(InputError, match=rf"depth\{suffix} is not a readable .*\(.*{message}"):
        read_depth(tmp_path / f"depth{suffix}", scale=1000)
