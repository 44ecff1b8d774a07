"""Write shards: the same samples come back bit for bit, other programs read them, and interrupted writing goes on."""

import json
import os
import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_disparity_pairs, write_pairs
from tests.shards.samples import THREE, Listed, same, sample, there_and_back
from torch.utils.data import Subset

from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.outputs.depth import write_depth_png
from zoedepth.shards.dataset import ShardDataset
from zoedepth.shards.index import read_index
from zoedepth.shards.writer import ShardSize, whole_numbers, write_shards
from zoedepth.train.run import licence_of


class TestThereAndBack:
    def test_samples_are_the_same_bit_for_bit(self, pairs: PairDataset, shards: Path):
        dataset = ShardDataset(shards)
        assert len(dataset) == 7
        assert all(same(dataset[i], pairs[i]) for i in (6, 0, 3, 2, 5, 1, 4))
        assert (dataset.domains, dataset.kinds) == (["indoor"], ["depth"])

    def test_photos_keep_the_bytes_of_their_files(self, pairs: PairDataset, shards: Path):
        with tarfile.open(shards / "pairs-000000.tar") as archive:
            names = archive.getnames()
            photo = archive.extractfile("00000001.jpg")
            assert photo is not None
            assert photo.read() == pairs.pairs[1].image.read_bytes()
        assert names == [f"0000000{i}.{end}" for i in range(3) for end in ("depth.png", "jpg", "json")]

    def test_stored_values_and_scale_are_those_of_the_source(self, tmp_path: Path):
        pairs = PairDataset(write_pairs(tmp_path / "pairs", n=1, size=(16, 24), domain="outdoor"))
        write_shards(pairs, tmp_path / "out", name="data", size=THREE)
        with tarfile.open(tmp_path / "out" / "data-000000.tar") as archive:
            stored = archive.extractfile("00000000.depth.png")
            about = archive.extractfile("00000000.json")
            assert stored is not None
            assert about is not None
            assert np.array_equal(np.asarray(Image.open(stored)), np.asarray(Image.open(pairs.pairs[0].target)))
            assert json.load(about)["depth_scale"] == 256

    def test_disparity(self, tmp_path: Path):
        pairs = PairDataset(write_disparity_pairs(tmp_path / "pairs", n=2, size=(16, 24)))
        write_shards(pairs, tmp_path / "out", name="data", size=THREE)
        dataset = ShardDataset(tmp_path / "out")
        assert all(same(dataset[i], pairs[i]) for i in range(2))
        assert (dataset.kinds, dataset.domains) == (["disparity"], [""])

    def test_samples_that_are_in_no_files(self, tmp_path: Path):
        camera = Intrinsics(50.5, 51, 0.25, -0.375)
        samples = [
            sample([[0.1, 0, 70.7]], camera=camera),  # not whole numbers of anything
            sample([[1.5, 0.25, 0]], domain="outdoor"),  # halves and quarters: exact in 16 bits of float
            sample([[0.123, 65.535, 0]]),  # millimetres
            sample([[-1.5, 0.0, 3.0]], kind="disparity", mask=torch.tensor([[[True, True, False]]])),
        ]
        samples[3] = replace(samples[3], target=torch.tensor([[[-1.5, 0.0, 0.0]]]))
        assert all(same(*two) for two in zip(there_and_back(tmp_path, samples), samples, strict=True))

    def test_licence_goes_with_the_data_and_with_what_is_trained_on_it(self, tmp_path: Path):
        samples = Listed([sample([[1.0]])])
        assert licence_of(samples) is None
        samples.licence = "CC BY-NC-SA 3.0"
        write_shards(samples, tmp_path, name="data", size=THREE)
        assert licence_of(Subset(ShardDataset(tmp_path), [0])) == "CC BY-NC-SA 3.0"

    @pytest.mark.parametrize("orientation", [1, 3, 6])
    def test_photos_that_exif_turns(self, tmp_path: Path, orientation: int):
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.effect_noise((6, 4), 100).save(tmp_path / "a.jpg", exif=exif)
        size = (6, 4) if orientation == 6 else (4, 6)
        write_depth_png(tmp_path / "a.png", np.full(size, 2, np.float32))
        (tmp_path / "list.csv").write_text("image,depth,domain\na.jpg,a.png,indoor\n")
        pairs = PairDataset(tmp_path / "list.csv")
        write_shards(pairs, tmp_path / "out", name="data", size=THREE)
        assert same(ShardDataset(tmp_path / "out")[0], pairs[0])
        with tarfile.open(tmp_path / "out" / "data-000000.tar") as archive:
            # Depth in shards does not say that it lies as the photo does.
            assert ("00000000.jpg" in archive.getnames()) == (orientation != 3)

    @pytest.mark.parametrize("scale", [1000, 256, 5000, 100, 1])
    def test_every_level_of_sixteen_bits_is_found_again(self, scale: int):
        levels = np.arange(65536, dtype=np.uint16)[None]
        found = whole_numbers(levels.astype(np.float32) / np.float32(scale), scale)
        assert found is not None
        assert np.array_equal(found, levels)

    @pytest.mark.parametrize("value", [0.0005, 65.5365, -1.0, float("nan"), float("inf")])
    def test_what_has_no_level_has_none(self, value: float):
        assert whole_numbers(np.array([[1.0, value]], np.float32), 1000) is None

    def test_other_programs_read_them(self, shards: Path):
        webdataset = pytest.importorskip("webdataset")
        paths = [str(path) for path in sorted(shards.glob("*.tar"))]
        rows = list(webdataset.WebDataset(paths, shardshuffle=False).decode("pil"))
        assert [row["__key__"] for row in rows] == [f"0000000{i}" for i in range(7)]
        assert rows[4]["jpg"].size == rows[4]["depth.png"].size == (24, 16)
        assert rows[4]["json"]["name"] == str(Path("image/train_004.jpg"))


class TestWriting:
    def test_bytes_are_the_same_every_time(self, pairs: PairDataset, shards: Path, tmp_path: Path):
        write_shards(pairs, tmp_path / "again", name="pairs", size=THREE, workers=2)
        names = sorted(path.name for path in shards.iterdir())
        assert names == ["index.json", *(f"pairs-00000{i}.tar" for i in range(3))]
        assert all((shards / name).read_bytes() == (tmp_path / "again" / name).read_bytes() for name in names)

    def test_size_in_bytes_is_kept(self, pairs: PairDataset, shards: Path, tmp_path: Path):
        # Room for two samples, not for three.
        room = int(ShardDataset(shards).index.shards[0].offsets[3]) - 1
        index = write_shards(pairs, tmp_path / "out", name="data", size=ShardSize(bytes=room))
        assert [len(shard) for shard in index.shards] == [2, 2, 2, 1]
        index = write_shards(pairs, tmp_path / "tiny", name="data", size=ShardSize(bytes=1))
        assert [len(shard) for shard in index.shards] == [1] * 7

    @pytest.mark.parametrize(
        ("text", "size"),
        [("500MB", ShardSize(500_000_000)), ("2 gb", ShardSize(2 * 10**9)), ("100", ShardSize(samples=100))],
    )
    def test_size_as_typed(self, text: str, size: ShardSize):
        assert ShardSize.parse(text) == size

    @pytest.mark.parametrize("text", ["", "0", "-1", "MB", "1.5GB", "5TB", "1e3"])
    def test_size_that_is_none(self, text: str):
        with pytest.raises(InputError, match="500MB"):
            ShardSize.parse(text)

    @pytest.mark.parametrize("workers", [0, 2])
    def test_interrupted_writing_goes_on(self, pairs: PairDataset, shards: Path, tmp_path: Path, workers: int):
        out, photo = tmp_path / "out", pairs.pairs[4].image
        content, before = photo.read_bytes(), photo.stat()
        photo.write_bytes(b"damaged")
        with pytest.raises(InputError, match=photo.name) as raised:
            write_shards(pairs, out, name="pairs", size=THREE, workers=workers)
        assert "Traceback" not in str(raised.value)
        assert sorted(path.name for path in out.iterdir()) == ["index.json", "pairs-000000.tar"]
        with pytest.raises(InputError, match="unfinished"):
            ShardDataset(out)

        photo.write_bytes(content)
        os.utime(photo, ns=(before.st_atime_ns, before.st_mtime_ns))
        begun, first = (out / "pairs-000000.tar").stat().st_ino, []
        write_shards(pairs, out, name="pairs", size=THREE, track=lambda samples, n: first.append(n) or samples)
        assert first == [3]
        assert (out / "pairs-000000.tar").stat().st_ino == begun
        assert all((out / path.name).read_bytes() == path.read_bytes() for path in shards.iterdir())

    @pytest.mark.parametrize("workers", [0, 2])
    def test_what_cannot_be_read_is_left_out_and_said(self, pairs: PairDataset, tmp_path: Path, workers: int):
        kept = {number: pairs.pairs[number].image.read_bytes() for number in (0, 4, 6)}
        for number in kept:
            pairs.pairs[number].image.write_bytes(b"damaged")
        out, told = tmp_path / "out", dict[int, str]()
        for _ in range(2):  # finished, only what follows the last sample is tried again
            told.clear()
            index = write_shards(pairs, out, name="pairs", size=THREE, workers=workers,
                                 on_failure=lambda number, error: told.update({number: str(error)}))  # fmt: skip
            assert index.skipped == (0, 4, 6)
            assert (out / "index.json").read_bytes() == index.to_json().encode()
            found = ShardDataset(out)
            assert [found[i].name for i in range(len(found))] == [pairs[i].name for i in (1, 2, 3, 5)]
            assert pairs.pairs[6].image.name in told[6]
        assert sorted(told) == [6]

        for number, content in kept.items():
            pairs.pairs[number].image.write_bytes(content)
        (out / "pairs-000000.tar").unlink()
        assert write_shards(pairs, out, name="pairs", size=THREE).skipped == ()
        assert all(same(ShardDataset(out)[i], pairs[i]) for i in range(7))

    def test_interrupted_writing_goes_on_behind_what_was_left_out(self, pairs: PairDataset, tmp_path: Path):
        pairs.pairs[1].image.write_bytes(b"damaged")
        reference, out = tmp_path / "whole", tmp_path / "out"
        write_shards(pairs, reference, name="pairs", size=THREE, on_failure=lambda *_: None)

        def until_the_fifth(samples: Iterable[object], _: int) -> Iterator[Any]:
            yield from islice(samples, 5)
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            write_shards(pairs, out, name="pairs", size=THREE, track=until_the_fifth, on_failure=lambda *_: None)
        assert read_index(out / "index.json").skipped == (1,)
        write_shards(pairs, out, name="pairs", size=THREE, on_failure=lambda *_: None)
        assert {path.name: path.read_bytes() for path in out.iterdir()} == {
            path.name: path.read_bytes() for path in reference.iterdir()
        }

    def test_an_index_that_leaves_out_too_much_is_of_other_samples(self, pairs: PairDataset, shards: Path):
        index = replace(read_index(shards / "index.json"), skipped=(1, 2))
        (shards / "index.json").write_text(index.to_json())
        with pytest.raises(InputError, match="other samples or of another size"):
            write_shards(pairs, shards, name="pairs", size=THREE)

    def test_data_that_cannot_be_read_at_all_is_an_error(self, pairs: PairDataset, tmp_path: Path, monkeypatch):
        for pair in pairs.pairs[1:]:
            pair.image.write_bytes(b"damaged")
        monkeypatch.setattr("zoedepth.shards.writer.MOST_SKIPPED", 3)
        with pytest.raises(InputError, match=pairs.pairs[4].image.name):
            write_shards(pairs, tmp_path / "out", name="pairs", size=THREE, on_failure=lambda *_: None)
        pairs.pairs[0].image.write_bytes(b"damaged")
        monkeypatch.setattr("zoedepth.shards.writer.MOST_SKIPPED", 9)
        with pytest.raises(InputError, match="none of the 7 samples can be read"):
            write_shards(pairs, tmp_path / "none", name="pairs", size=THREE, on_failure=lambda *_: None)

    def test_finished_writing_writes_nothing(self, pairs: PairDataset, shards: Path):
        before = {path.name: path.stat().st_ino for path in shards.iterdir()}
        write_shards(pairs, shards, name="pairs", size=THREE)
        assert {path.name: path.stat().st_ino for path in shards.iterdir()} == before

    def test_a_unit_that_was_put_right_since_is_said(self, pairs: PairDataset, shards: Path):
        for place, pair in enumerate(pairs.pairs):
            if place == 4:
                pairs.pairs[place] = replace(pair, scale=4.0 * pair.scale)
        with pytest.raises(InputError, match=r"samples 3 to 5, or what is said of them, have changed"):
            write_shards(pairs, shards, name="pairs", size=THREE)

    def test_a_mark_for_unknown_depth_that_was_said_since_is_noticed(self, tmp_path: Path):
        """Also where the first sample has none of it."""
        folder = write_pairs(tmp_path / "pairs", n=2, size=(16, 24)).parent
        (folder / "train.csv").unlink()
        for number, metres in enumerate((2.0, 60.0)):
            write_depth_png(folder / f"depth/train_00{number}.png", np.full((16, 24), metres, np.float32))
        about = {"domain": "indoor", "depth_scale": 1000}
        for said in (about, {**about, "max_depth": 50}):
            (folder / "dataset.json").write_text(json.dumps(said))
            if "max_depth" not in said:
                write_shards(PairDataset(folder), tmp_path / "shards", name="pairs", size=THREE)
        with pytest.raises(InputError, match="samples 0 to 1, or what is said of them, have changed"):
            write_shards(PairDataset(folder), tmp_path / "shards", name="pairs", size=THREE)

    def test_files_that_have_changed_since_are_said(self, pairs: PairDataset, shards: Path):
        """Also where the first sample, and all the numbers, are what they were."""
        path = pairs.pairs[4].target
        assert path is not None
        write_depth_png(path, np.full((16, 24), 7, np.float32))
        before = {path.name: path.read_bytes() for path in shards.iterdir()}
        changed = r"samples 3 to 5, or what is said of them, have changed since .*pairs-000001\.tar was written"
        with pytest.raises(InputError, match=changed):
            write_shards(pairs, shards, name="pairs", size=THREE)
        assert {path.name: path.read_bytes() for path in shards.iterdir()} == before
        (shards / "pairs-000001.tar").unlink()
        write_shards(pairs, shards, name="pairs", size=THREE)
        assert all(same(ShardDataset(shards)[i], pairs[i]) for i in (0, 4, 6))

    def test_lost_shard_is_written_again(self, pairs: PairDataset, shards: Path):
        content = (shards / "pairs-000001.tar").read_bytes()
        (shards / "pairs-000001.tar").unlink()
        write_shards(pairs, shards, name="pairs", size=THREE)
        assert (shards / "pairs-000001.tar").read_bytes() == content

    def test_shards_of_something_else_are_not_touched(self, pairs: PairDataset, shards: Path, tmp_path: Path):
        before = {path.name: path.read_bytes() for path in shards.iterdir()}
        other = PairDataset(write_pairs(tmp_path / "other", n=7, size=(16, 24), domain="outdoor"))
        for arguments in ({"size": ShardSize(samples=2)}, {"name": "others"}, {"dataset": other}):
            with pytest.raises(InputError, match="other samples or of another size"):
                write_shards(**{"dataset": pairs, "out": shards, "name": "pairs", "size": THREE, **arguments})
        assert {path.name: path.read_bytes() for path in shards.iterdir()} == before

    @pytest.mark.parametrize("name", ["", "a/b", "..", "a b", "a.b"])
    def test_name_that_is_no_name_of_a_file(self, pairs: PairDataset, tmp_path: Path, name: str):
        with pytest.raises(InputError, match="letters, digits"):
            write_shards(pairs, tmp_path / "out", name=name, size=THREE)

    def test_nothing_to_write(self, tmp_path: Path):
        with pytest.raises(InputError, match="no samples"):
            write_shards(Listed([]), tmp_path / "out", name="data", size=THREE)
