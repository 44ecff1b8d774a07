"""Hashes that tell weights and lists apart."""

import hashlib
from pathlib import Path

from zoedepth.evaluation.identity import list_fingerprint, weights_fingerprint

CONTENT = b"x" * (1 << 20) + b"end"  # more than is read at a time
EXPECTED = hashlib.sha256(CONTENT).hexdigest()[:16]


def test_weights_are_those_of_the_file_or_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "model.safetensors").write_bytes(CONTENT)
    (tmp_path / "config.json").write_text("{}")
    assert weights_fingerprint(tmp_path) == weights_fingerprint(tmp_path / "model.safetensors") == EXPECTED


def test_list_is_the_file_or_the_test_list_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "test.csv").write_bytes(CONTENT)
    (tmp_path / "train.csv").write_bytes(b"other")
    assert list_fingerprint(str(tmp_path)) == list_fingerprint(str(tmp_path / "test.csv")) == EXPECTED
    assert list_fingerprint(str(tmp_path / "train.csv")) != EXPECTED


def test_data_without_a_list_has_none(tmp_path: Path) -> None:
    assert list_fingerprint(str(tmp_path)) is None
    assert list_fingerprint("synthetic:rooms") is None
