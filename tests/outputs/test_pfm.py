"""Portable float maps, byte by byte."""

from pathlib import Path

import numpy as np

from zoedepth.outputs.pfm import write_pfm


def test_has_the_bottom_row_first_in_little_endian_order(tmp_path: Path) -> None:
    write_pfm(tmp_path / "folder" / "a.pfm", np.array([[1, 2, np.nan], [4, -5, 6]], np.float32))
    content = (tmp_path / "folder" / "a.pfm").read_bytes()
    assert content == b"Pf\n3 2\n-1.0\n" + np.array([4, 0, 6, 1, 2, 0], "<f4").tobytes()
