"""Arrays of NumPy and portable float maps are read as written; lies about their size are refused."""

from pathlib import Path

import numpy as np
import pytest
from tests import bombs

from zoedepth.errors import InputError
from zoedepth.images import MAX_PIXELS
from zoedepth.stored import Memory, read_depth, read_npy, read_pfm, read_pgm, read_stored

METRES = np.array([[0.5, 1.25, 0], [300.25, 2, 65.5]], np.float32)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archives_of_many_pieces(tmp_path: Path, save) -> None:
    noise = np.random.default_rng(0).random((700, 900), np.float32)
    save(tmp_path / "depth.npz", depth=noise)
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.npz"), noise)


def test_archive_without_depth_is_an_error_that_says_what_it_has(tmp_path: Path) -> None:
    for arrays, said in (({"metres": METRES}, "metres"), ({"arr_0": METRES, "arr_1": METRES}, "arr_0, arr_1")):
        np.savez(tmp_path / "depth.npz", **arrays)
        with pytest.raises(InputError, match=rf"depth\.npz.*no array 'depth', but {said}\. Save the one of depth"):
            read_depth(tmp_path / "depth.npz")
    np.savez(tmp_path / "depth.npz")
    with pytest.raises(InputError, match="no array 'depth', but none at all"):
        read_depth(tmp_path / "depth.npz")


def test_the_only_array_needs_no_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "depth.npz", METRES)
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.npz"), METRES)


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


@pytest.mark.parametrize(
    "header",
    ["P5\n3 2\n65535\n", "P5 3 2 4095 ", "P5\n# by a camera\n3 2\n# of 10 bits\n1023\n", "P5\r\n3\t2\r\n65535\n"],
)
def test_pgm_of_16_bits_has_the_values_as_they_are_stored(tmp_path: Path, header: str) -> None:
    levels = np.array([[0, 1, 256], [1000, 4095, 10]], np.uint16)
    (tmp_path / "a.pgm").write_bytes(header.encode() + levels.astype(">u2").tobytes())
    found = read_pgm(tmp_path / "a.pgm")
    np.testing.assert_array_equal(found, levels)
    assert found.dtype == np.uint16  # of this machine's byte order
    np.testing.assert_array_equal(read_depth(tmp_path / "a.pgm", scale=1000), levels / np.float32(1000))
    with pytest.raises(InputError, match=r"a\.pgm does not say its scale"):
        read_depth(tmp_path / "a.pgm")


@pytest.mark.parametrize("header", ["P5\r\n3 2\r\n65535\r\n", "P5 3 2 65535\n# millimetres\n"])
def test_pgm_whose_header_ends_with_more_than_one_blank_is_refused(tmp_path: Path, header: str) -> None:
    levels = np.arange(6, dtype=">u2").reshape(2, 3)  # as text of Windows, and with a comment at the end
    (tmp_path / "a.pgm").write_bytes(header.encode() + levels.tobytes())
    with pytest.raises(InputError, match=r"a\.pgm is not a readable PGM.*more follows its pixels"):
        read_pgm(tmp_path / "a.pgm")


def test_pgm_of_several_maps_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(2 * (b"P5 40 50 65535\n" + bytes(4000)))  # the second beyond what is read first
    with pytest.raises(InputError, match=r"a\.pgm.*it holds several maps"):
        read_pgm(tmp_path / "a.pgm")


def test_pgm_of_8_bits(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5 3 1 255\n\x0a\x00\xff")  # the first value is a line's end, too
    assert read_pgm(tmp_path / "a.pgm").tolist() == [[10, 0, 255]]
    with pytest.raises(InputError, match="8 bits a pixel"):
        read_depth(tmp_path / "a.pgm", scale=1)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "it is empty"),
        (b"P2\n1 1\n255\n7", "begins with P5"),
        (b"P6\n1 1\n255\n123", "begins with P5"),
        (b"P5\n2 2\n65535\n1234567", "cut short"),
        (b"P5\n2 2\n65536\n" + bytes(8), "greatest value is 65536"),
        (b"P5\n0 2\n255\n", "one map"),
        (b"P5\n999999999 999999999\n255\n", "more than"),
        (b"P5\n" + b"#\n" * 100_000, "begins with P5"),
    ],
    ids=range(8),
)
def test_pgm_that_is_none(tmp_path: Path, content: bytes, word: str) -> None:
    (tmp_path / "a.pgm").write_bytes(content)
    with pytest.raises(InputError, match=rf"a\.pgm is not a readable PGM.*{word}"):
        read_pgm(tmp_path / "a.pgm")


def test_portable_maps_in_memory() -> None:
    pfm = b"Pf\n1 1\n-1\n" + np.float32(1.5).tobytes()
    assert read_stored(Memory(pfm, "a", ".pfm")).values.tolist() == [[1.5]]
    assert read_stored(Memory(b"P5 1 1 65535 \1\0", "a", ".pgm")).values.tolist() == [[256]]


def test_map_of_as_many_pixels_as_a_photo_is_no_bomb(tmp_path: Path) -> None:
    """Only the limit is looked at: the header says how many, and nothing follows."""
    side = int(MAX_PIXELS**0.5)
    (tmp_path / "a.npy").write_bytes(bombs.npy_header((side, side)))
    with pytest.raises(InputError, match="cut short"):
        read_npy(tmp_path / "a.npy")
    (tmp_path / "a.npy").write_bytes(bombs.npy_header((side + 1, side + 1)))
    with pytest.raises(InputError, match="more than"):
        read_npy(tmp_path / "a.npy")
