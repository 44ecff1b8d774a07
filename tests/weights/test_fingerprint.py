"""Hashes of weights and of plain values, and the state of files."""

import os
from pathlib import Path

import numpy as np
import pytest

from zoedepth.weights.fingerprint import files_state, fingerprint, weights_fingerprint


def test_weights_of_a_file_and_of_its_folder_are_known_by_their_content(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    path.write_bytes(b"x" * (1 << 20) + b"end")  # more than is read at a time
    before = weights_fingerprint(path)
    assert weights_fingerprint(tmp_path) == before
    os.utime(path, (0, 0))
    assert weights_fingerprint(path) == before
    path.write_bytes(b"x" * (1 << 20) + b"END")
    assert weights_fingerprint(path) == weights_fingerprint(tmp_path) != before


@pytest.mark.parametrize(
    ("given", "changed"),
    [
        ("", "config.json"),
        ("", "preprocessor_config.json"),
        ("model.xml", "model.bin"),
        ("run", "run/checkpoints/2.pt"),
    ],
)
def test_what_belongs_to_the_weights_counts_too(tmp_path: Path, given: str, changed: str) -> None:
    """The config of a folder, OpenVINO's weights beside its graph, and all files of a folder of another kind."""
    (tmp_path / "run/checkpoints").mkdir(parents=True)
    for name in ("model.safetensors", "model.xml", changed):
        (tmp_path / name).write_bytes(b"a")
    before = weights_fingerprint(tmp_path / given)
    assert weights_fingerprint(tmp_path / given) == before
    (tmp_path / changed).write_bytes(b"ab")
    assert weights_fingerprint(tmp_path / given) != before


def test_file_with_the_size_and_time_of_the_old_one_is_another(tmp_path: Path) -> None:
    path = tmp_path / "0.npy"
    np.save(path, np.zeros(4))
    before, times = files_state([path]), path.stat()
    assert files_state([path]) == before
    np.save(tmp_path / "new.npy", np.ones(4))
    (tmp_path / "new.npy").replace(path)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    after = files_state([path])
    assert [state[:3] for state in after if state] == [state[:3] for state in before if state]
    assert after != before


def test_missing_file_has_no_state_and_folders_are_passed_over(tmp_path: Path) -> None:
    assert files_state([tmp_path, tmp_path / "none"]) == [None]


def test_fingerprint_does_not_depend_on_the_order_of_keys() -> None:
    values = {"a": 1, "b": [Path("x"), None]}
    assert fingerprint(values) == fingerprint(dict(reversed(values.items())))
    assert fingerprint(values) != fingerprint({**values, "a": 2})
