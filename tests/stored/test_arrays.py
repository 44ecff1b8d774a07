"""Arrays of NumPy and portable float maps are read as written; lies about their size are refused."""

from pathlib import Path

import numpy as np
import pytest
from tests import bombs

from zoedepth.errors import InputError
from zoedepth.images import MAX_PIXELS
from zoedepth.stored import read_depth, read_npy, read_pfm

METRES = np.array([[0.5, 1.25, 0], [300.25, 2, 65.5]], np.float32)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archives_of_many_pieces(tmp_path: Path, save) -> None:
    noise = np.random.default_rng(0).random((700, 900), np.float32)
    save(tmp_path / "depth.npz", depth=noise)
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.npz"), noise)


def test_whole_numbers_in_an_array_are_metres_too(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.array([[3, 0]], np.int64))
    assert read_depth(tmp_path / "depth.npy").tolist() == [[3, 0]]


def test_archive_without_depth_is_an_error_that_says_what_it_has(tmp_path: Path) -> None:
    np.savez(tmp_path / "depth.npz", metres=METRES)
    with pytest.raises(InputError, match=r"depth\.npz.*no array 'depth', but \['metres'\]"):
        read_depth(tmp_path / "depth.npz")


def test_pfm_is_turned_upright_in_either_byte_order(tmp_path: Path) -> None:
    for sign, order in (("-1.0", "<f4"), ("1.0", ">f4")):
        (tmp_path / "a.pfm").write_bytes(f"Pf\n3 2\n{sign}\n".encode() + METRES[::-1].astype(order).tobytes())
        np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), METRES)


@pytest.mark.parametrize(
    "content", [b"", b"PF\n1 1\n-1\n" + bytes(12), b"Pf\n0 1\n-1\n", b"Pf\n1\n-1\n", b"Pf\n2 2\n-1\n"]
)
def test_pfm_that_is_none(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.pfm").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.pfm is not a readable PFM"):
        read_pfm(tmp_path / "a.pfm")


def test_map_of_as_many_pixels_as_a_photo_is_no_bomb(tmp_path: Path) -> None:
    """Only the limit is looked at: the header says how many, and nothing follows."""
    side = int(MAX_PIXELS**0.5)
    (tmp_path / "a.npy").write_bytes(bombs.npy_header((side, side)))
    with pytest.raises(InputError, match="cut short"):
        read_npy(tmp_path / "a.npy")
    (tmp_path / "a.npy").write_bytes(bombs.npy_header((side + 1, side + 1)))
    with pytest.raises(InputError, match="more than"):
        read_npy(tmp_path / "a.npy")
