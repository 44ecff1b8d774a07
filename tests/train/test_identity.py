"""The state of data and of starting weights: it changes with them, and with nothing else."""

import os
from pathlib import Path

import pytest
import torch
from tests.folders import write_pairs

from zoedepth.data.pairs import PairDataset
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.opening import open_dataset
from zoedepth.shards.writer import ShardSize, write_shards
from zoedepth.train.identity import data_state, same_start, start_state
from zoedepth.weights.save import save_model


def test_data_is_known_by_its_files_and_by_what_is_said_of_them(tmp_path: Path) -> None:
    source = str(write_pairs(tmp_path, n=2, size=(8, 8)))

    def state() -> str:
        return data_state(open_dataset(source, keep_missing=True), source)

    states = [state()]
    assert state() == states[0]
    depth = tmp_path / "depth/train_001.png"
    os.utime(depth, ns=(1, 1))
    states.append(state())
    depth.write_bytes(depth.read_bytes() + b"\0")
    states.append(state())
    depth.unlink()
    states.append(state())
    (tmp_path / "dataset.json").write_text('{"max_depth": 60}')
    states.append(state())
    assert len(set(states)) == 5


def test_other_data_is_known_by_the_files_of_its_folder(tmp_path: Path) -> None:
    scenes = open_dataset("synthetic:rooms?n=1&size=32x32")
    (tmp_path / "part").write_text("1")
    before = data_state(scenes, str(tmp_path))
    assert data_state(scenes, str(tmp_path)) == before
    (tmp_path / "part").write_text("22")
    assert data_state(scenes, str(tmp_path)) != before


def test_shards_are_known_by_themselves_and_what_is_said_of_them(tmp_path: Path) -> None:
    folder = tmp_path / "all/train"
    write_shards(PairDataset(write_pairs(tmp_path, n=2)), folder, name="data", size=ShardSize(samples=1))

    def state() -> str:
        return data_state(open_dataset(tmp_path / "all"), str(tmp_path / "all"))

    before = state()
    (tmp_path / "all/run").mkdir()
    (tmp_path / "all/run/log.jsonl").write_text("{}")
    assert state() == before
    (folder / "dataset.json").write_text('{"max_depth": 5}')
    said = state()
    os.utime(folder / "data-000001.tar", ns=(1, 1))
    assert len({before, said, state()}) == 3


def test_weights_are_known_by_their_content_and_not_by_the_texts_beside_it(
    tiny_model: ZoeDepth, tmp_path: Path
) -> None:
    file = tmp_path / "run/step_000003/model.safetensors"
    save_model(tiny_model, file)
    name, content = start_state(str(file))
    assert (name, start_state(str(tmp_path / "run"))[1]) == (str(file), content)
    header = int.from_bytes(file.read_bytes()[:8], "little")
    data = file.read_bytes()
    file.write_bytes((header + 8).to_bytes(8, "little") + data[8 : 8 + header] + b" " * 8 + data[8 + header :])
    assert start_state(str(file))[1] == content
    with torch.no_grad():
        next(tiny_model.parameters()).add_(1)
    save_model(tiny_model, file)
    assert start_state(str(file))[1] != content
    assert start_state(None) == [None, None]
    assert start_state("zoed-lite") == ["zoed-lite", None]


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (["a", "1"], ["a", "1"], True),
        (["a", "1"], ["a", "2"], False),
        (["a", "1"], ["/w/a", "1"], True),  # the same file by another path
        (["a", "1"], ["a", None], True),  # gone by now
        (["a", "1"], ["b", None], False),
        (["a", None], ["b", None], False),
        ([None, None], ["a", None], False),
        ({"a": 1}, {"a": 1}, True),
    ],
)
def test_weights_agree_by_their_content_or_their_name(first: object, second: object, same: bool) -> None:
    assert same_start(first, second) == same
