"""The index of shards: read back as written, and refused where it is damaged."""

import json
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from tests.shards.samples import PHOTO, png, tar_of

from zoedepth.errors import InputError
from zoedepth.shards.dataset import ShardDataset
from zoedepth.shards.index import Index, Shard, read_index


class TestIndex:
    @pytest.mark.parametrize(
        ("change", "word"),
        [
            ({"format": "other"}, "is no index"),
            ({"format": None}, "is no index"),
            ({"shards": None}, "damaged"),
            ({"shards": []}, "lists no shards"),
            ({"shards": [3]}, "damaged"),
            ({"name": "../pairs-000000.tar"}, "damaged"),
            ({"name": "/pairs-000000.tar"}, "damaged"),
            ({"name": ".hidden.tar"}, "damaged"),
            ({"name": "pairs.zip"}, "damaged"),
            ({"name": 7}, "damaged"),
            ({"name": "other.tar"}, r"other\.tar, which is not beside"),
            ({"sha256": "no hash"}, "damaged"),
            ({"offsets": [0]}, "damaged"),
            ({"offsets": [0, 0]}, "damaged"),
            ({"offsets": [512, 0]}, "damaged"),
            ({"offsets": [-512, 0]}, "damaged"),
            ({"offsets": [0, 10**12]}, "damaged"),
            ({"offsets": [0, 10**30]}, "damaged"),
            ({"offsets": [0, 10**6]}, "cut short"),
            ({"offsets": ["0", "x"]}, "damaged"),
            ({"offsets": [[0, 512]]}, "damaged"),
        ],
        ids=str,
    )
    def test_damaged_index_is_an_error_that_says_so(self, shards: Path, change: dict[str, object], word: str):
        record = json.loads((shards / "index.json").read_text())
        target = record if change.keys() & {"format", "shards"} else record["shards"][0]
        target.update(change)
        (shards / "index.json").write_text(json.dumps(record))
        with pytest.raises(InputError, match=word):
            ShardDataset(shards)

    @pytest.mark.parametrize("text", ["", "[]", "{}", "[" * 100_000])
    def test_file_that_is_no_index(self, shards: Path, text: str):
        (shards / "index.json").write_text(text)
        with pytest.raises(InputError, match=r"index\.json"):
            ShardDataset(shards / "index.json")

    @pytest.mark.parametrize("value", ["[]", "{}", '"aaa"', "257"])
    def test_index_of_millions_of_values(self, shards: Path, value: str):
        """Twenty million brackets took 17 s and 1.6 GB."""
        (shards / "index.json").write_text('{"a":[' + f"{value}," * 2_500_000 + "1]}")
        with pytest.raises(InputError, match=r"index\.json is no index of shards, or one of more than two million"):
            ShardDataset(shards)

    def test_index_of_a_million_samples_is_read(self, tmp_path: Path):
        offsets = np.arange(1001) * 10**6
        index = Index([Shard(f"{number}.tar", offsets, "a" * 64) for number in range(1000)], ["indoor"], ["depth"])
        (tmp_path / "index.json").write_text(index.to_json())
        assert sum(map(len, read_index(tmp_path / "index.json").shards)) == 1_000_000

    def test_offsets_that_point_elsewhere_are_an_error_that_names_shard_and_sample(self, shards: Path):
        record = json.loads((shards / "index.json").read_text())
        record["shards"][1]["offsets"][1] += 100
        (shards / "index.json").write_text(json.dumps(record))
        dataset = ShardDataset(shards)
        for index in (3, 4):
            with pytest.raises(InputError, match=r"pairs-000001\.tar, sample [01]"):
                dataset[index]

    def test_folder_without_shards(self, tmp_path: Path):
        with pytest.raises(InputError, match=r"no shards"):
            ShardDataset(tmp_path)


def test_names_that_look_the_same_are_of_one_sample(tmp_path: Path) -> None:
    apart, together = (unicodedata.normalize(form, "Küche") for form in ("NFD", "NFC"))
    depth = png(np.array([[1000, 2000]], np.uint16))
    path = tar_of(tmp_path / "a.tar", {f"{apart}.png": PHOTO, f"{together}.depth.png": depth})
    dataset = ShardDataset(path, depth_scale=1000, domain="indoor")
    assert [sample.target[0].tolist() for sample in (dataset[i] for i in range(len(dataset)))] == [[[1, 2]]]
