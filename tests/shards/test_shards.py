"""Shards: the same samples back, in any order and process, from disk and the web; and what is wrong with a shard."""

import hashlib
import io
import json
import pickle
import tarfile
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_disparity_pairs, write_pairs
from tests.servers import LocalServer
from torch.utils.data import DataLoader, Dataset

from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.shards.dataset import WINDOW, ShardDataset
from zoedepth.shards.index import Index
from zoedepth.shards.writer import ShardSize, whole_numbers, write_shards

THREE = ShardSize(samples=3)


class Listed(Dataset[Sample]):
    """Samples that are nowhere in files."""

    def __init__(self, samples: list[Sample]) -> None:
        self.samples = samples

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Sample:
        return self.samples[index]


def sample(target: list[list[float]], **changes: object) -> Sample:
    """A grey photo with these depths, known where they are not 0."""
    depth = torch.tensor(target)[None]
    grey = torch.full((3, *depth.shape[1:]), 128 / 255)
    return replace(Sample(grey, depth, depth > 0, "depth", "indoor", "made"), **changes)  # type: ignore[arg-type]


def same(one: Sample, other: Sample) -> bool:
    """Bit for bit."""
    tensors = ((one.image, other.image), (one.target, other.target), (one.mask, other.mask))
    facts = [(s.kind, s.domain, s.name, s.camera) for s in (one, other)]
    return all(torch.equal(a, b) for a, b in tensors) and facts[0] == facts[1]


def there_and_back(folder: Path, samples: list[Sample]) -> list[Sample]:
    write_shards(Listed(samples), folder, name="data", size=THREE)
    dataset = ShardDataset(folder)
    return [dataset[i] for i in range(len(dataset))]


@pytest.fixture
def pairs(tmp_path: Path) -> PairDataset:
    """Seven pairs."""
    return PairDataset(write_pairs(tmp_path / "pairs", n=7, size=(16, 24)))


@pytest.fixture
def shards(pairs: PairDataset, tmp_path: Path) -> Path:
    """Three shards of three, three and one."""
    write_shards(pairs, tmp_path / "shards", name="pairs", size=THREE)
    return tmp_path / "shards"


def tar_of(path: Path, members: dict[str, bytes], **options: str) -> Path:
    """A tar file as other programs write it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, **{"mode": "w", **options}) as archive:  # type: ignore[call-overload]
        for name, content in members.items():
            header = tarfile.TarInfo(name)
            header.size, header.mtime = len(content), 1_700_000_000
            archive.addfile(header, io.BytesIO(content))
    return path


def png(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(values).save(file, "PNG")
    return file.getvalue()


PHOTO = png(np.full((1, 2, 3), 128, np.uint8))
DEPTH = png(np.array([[500, 2000]], np.uint16))
ABOUT = b'{"depth_scale": 1000, "domain": "indoor", "name": "a photo"}'
MEMBERS = {"0.png": PHOTO, "0.depth.png": DEPTH, "0.json": ABOUT}


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
            assert np.array_equal(np.asarray(Image.open(stored)), np.asarray(Image.open(pairs.pairs[0].target)))  # type: ignore[arg-type]
            assert json.load(about)["depth_scale"] == 256

    def test_disparity(self, tmp_path: Path):
        pairs = PairDataset(write_disparity_pairs(tmp_path / "pairs", n=2, size=(16, 24)))
        write_shards(pairs, tmp_path / "out", name="data", size=THREE)
        dataset = ShardDataset(tmp_path / "out")
        assert all(same(dataset[i], pairs[i]) for i in range(2))
        assert (dataset.kinds, dataset.domains) == (["disparity"], [""])

    def test_samples_that_are_in_no_files(self, tmp_path: Path):
        camera = Intrinsics(500.5, 501, 0.25, -3)
        samples = [
            sample([[0.1, 0, 70.7]], camera=camera),  # not whole numbers of anything
            sample([[1.5, 0.25, 0]], domain="outdoor"),  # halves and quarters: exact in 16 bits of float
            sample([[0.123, 65.535, 0]]),  # millimetres
            sample([[-1.5, 0.0, 3.0]], kind="disparity", mask=torch.tensor([[[True, True, False]]])),
        ]
        samples[3] = replace(samples[3], target=torch.tensor([[[-1.5, 0.0, 0.0]]]))
        assert all(same(*two) for two in zip(there_and_back(tmp_path, samples), samples, strict=True))

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
        content = photo.read_bytes()
        photo.write_bytes(b"damaged")
        with pytest.raises(InputError, match=photo.name) as raised:
            write_shards(pairs, out, name="pairs", size=THREE, workers=workers)
        assert "Traceback" not in str(raised.value)
        assert sorted(path.name for path in out.iterdir()) == ["index.json", "pairs-000000.tar"]
        with pytest.raises(InputError, match="unfinished"):
            ShardDataset(out)

        photo.write_bytes(content)
        begun, first = (out / "pairs-000000.tar").stat().st_ino, []
        write_shards(pairs, out, name="pairs", size=THREE, track=lambda samples, n: first.append(n) or samples)
        assert first == [3]
        assert (out / "pairs-000000.tar").stat().st_ino == begun
        assert all((out / path.name).read_bytes() == path.read_bytes() for path in shards.iterdir())

    def test_finished_writing_writes_nothing(self, pairs: PairDataset, shards: Path):
        before = {path.name: path.stat().st_ino for path in shards.iterdir()}
        write_shards(pairs, shards, name="pairs", size=THREE)
        assert {path.name: path.stat().st_ino for path in shards.iterdir()} == before

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
                write_shards(**{"dataset": pairs, "out": shards, "name": "pairs", "size": THREE, **arguments})  # type: ignore[arg-type]
        assert {path.name: path.read_bytes() for path in shards.iterdir()} == before

    @pytest.mark.parametrize("name", ["", "a/b", "..", "a b", "a.b"])
    def test_name_that_is_no_name_of_a_file(self, pairs: PairDataset, tmp_path: Path, name: str):
        with pytest.raises(InputError, match="letters, digits"):
            write_shards(pairs, tmp_path / "out", name=name, size=THREE)

    def test_nothing_to_write(self, tmp_path: Path):
        with pytest.raises(InputError, match="no samples"):
            write_shards(Listed([]), tmp_path / "out", name="data", size=THREE)


class TestReading:
    def test_workers_read_what_one_process_reads(self, pairs: PairDataset, shards: Path):
        dataset = ShardDataset(shards)
        dataset[0]  # its file is open when the workers begin
        loader = DataLoader(dataset, batch_size=None, num_workers=2)
        assert all(same(got, pairs[i]) for i, got in enumerate(loader))

    def test_copy_reads_too(self, shards: Path):
        dataset = ShardDataset(shards)
        dataset[0]
        assert same(pickle.loads(pickle.dumps(dataset))[3], dataset[3])

    def test_more_shards_than_files_may_be_open(
        self, pairs: PairDataset, shards: Path, monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.setattr("zoedepth.shards.dataset._MAX_OPEN", 1)
        dataset = ShardDataset(shards)
        assert all(same(dataset[i], pairs[i]) for i in (0, 6, 1, 5))
        assert len(dataset._files._open) == 1

    def test_numbers_beyond_the_end(self, shards: Path):
        dataset = ShardDataset(shards)
        assert same(dataset[-1], dataset[6])
        with pytest.raises(IndexError):
            dataset[7]

    def test_order_has_every_sample_once(self, shards: Path):
        dataset = ShardDataset(shards)
        orders = [dataset.order(np.random.default_rng(seed)).tolist() for seed in (0, 0, 1)]
        assert [sorted(order) for order in orders] == [list(range(7))] * 3
        assert orders[0] == orders[1] != orders[2]

    def test_order_goes_through_few_shards_at_a_time(self, shards: Path):
        """Ten shards of five: in each stretch of WINDOW times five samples there are WINDOW shards, mixed."""
        dataset = ShardDataset(shards)
        shard = dataset.index.shards[0]
        dataset.index = Index([replace(shard, offsets=np.arange(6))] * 10, ["indoor"], ["depth"])
        dataset._starts = np.arange(0, 51, 5)
        owners = dataset.order(np.random.default_rng(0)) // 5
        stretches = [owners[first : first + 5 * WINDOW].tolist() for first in range(0, 50, 5 * WINDOW)]
        assert [len(set(stretch)) for stretch in stretches] == [4, 4, 2]
        assert len(set(stretches[0][:6])) > 2


class TestShardsOfOthers:
    def test_headers_tell_what_an_index_would(self, shards: Path):
        known = ShardDataset(shards)
        (shards / "index.json").unlink()
        found = ShardDataset(shards)
        assert [shard.offsets.tolist() for shard in found.index.shards] == [
            shard.offsets.tolist() for shard in known.index.shards
        ]
        assert (found.domains, found.kinds) == (known.domains, known.kinds)
        assert all(same(found[i], known[i]) for i in range(7))

    @pytest.mark.parametrize("format", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
    def test_folders_long_names_and_other_members(self, tmp_path: Path, format: int):
        long = "scene/" + "x" * (200 if format != tarfile.USTAR_FORMAT else 20)
        members = {
            f"{long}.JPG": PHOTO, f"{long}.cls": b"7", f"{long}.depth.png": DEPTH, f"{long}.json": ABOUT,
            "scene/b.rgb.png": PHOTO, "scene/._b.rgb.png": b"", "scene/b.depth_map.png": DEPTH, "readme": b"",
        }  # fmt: skip
        path = tar_of(tmp_path / "a.tar", members, format=format)  # type: ignore[arg-type]
        dataset = ShardDataset(path, depth_scale=500, domain="hall")
        assert [dataset[i].target[0].tolist() for i in range(2)] == [[[0.5, 2]], [[1, 4]]]
        assert [dataset[i].domain for i in range(2)] == ["indoor", "hall"]
        assert (dataset[0].name, dataset.domains) == ("a photo", ["hall", "indoor"])

    def test_mask_and_floats(self, tmp_path: Path):
        file = io.BytesIO()
        np.save(file, np.array([[1.5, 2.5]]))
        members = {"0.png": PHOTO, "0.depth.npy": file.getvalue(), "0.mask.png": png(np.array([[0, 9]], np.uint8))}
        assert ShardDataset(tar_of(tmp_path / "a.tar", members), domain="indoor")[0].target[0].tolist() == [[0, 2.5]]

    @pytest.mark.parametrize(
        ("changes", "word"),
        [
            ({"0.png": None}, "one photo"),
            ({"0.depth.png": None}, "one photo"),
            ({"0.jpg": PHOTO}, "one photo"),
            ({"0.depth.npy": b""}, "one photo"),
            ({"0.json": None}, "domain"),
            ({"0.json": b"[]"}, "JSON"),
            ({"0.json": b'{"depth_scale": "mm"}'}, "depth_scale"),
            ({"0.json": b" " * 100_000}, "longer"),
        ],
    )
    def test_sample_that_is_none_is_an_error_that_names_shard_and_sample(
        self, tmp_path: Path, changes: dict[str, bytes | None], word: str
    ):
        members = {name: content for name, content in (MEMBERS | changes).items() if content is not None}
        with pytest.raises(InputError, match=rf"a\.tar, sample '0'.*{word}"):
            ShardDataset(tar_of(tmp_path / "a.tar", members))

    @pytest.mark.parametrize(
        "changes",
        [
            {"0.png": PHOTO[:40]},
            {"0.depth.png": DEPTH[:40]},
            {"0.depth.png": PHOTO},
            {"0.depth.png": png(np.ones((3, 3), np.uint16))},
            {"0.json": b'{"domain": "indoor"}'},
            {"0.mask.png": b""},
        ],
        ids=["photo", "depth", "three channels", "size", "no unit", "mask"],
    )
    def test_damaged_member_is_an_error_that_names_shard_and_sample(self, tmp_path: Path, changes: dict[str, bytes]):
        dataset = ShardDataset(tar_of(tmp_path / "a.tar", {"x.png": PHOTO, "x.depth.png": DEPTH, "x.json": ABOUT,
                                                           **MEMBERS, **changes}))  # fmt: skip
        dataset[0]
        with pytest.raises(InputError, match=r"a\.tar, sample 1"):
            dataset[1]

    def test_names_are_not_paths(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        members = {f"../../{name}": content for name, content in MEMBERS.items()}
        members["../../0.json"] = json.dumps({**json.loads(ABOUT), "name": "/etc/passwd"}).encode()
        (tmp_path / "here" / "below").mkdir(parents=True)
        dataset = ShardDataset(tar_of(tmp_path / "here" / "below" / "a.tar", members))
        assert dataset[0].name == "/etc/passwd"
        assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.rglob("*.*"))] == ["here/below/a.tar"]

    def test_pickles_are_not_read(self, tmp_path: Path):
        file = io.BytesIO()
        np.save(file, np.array([[object()]]), allow_pickle=True)
        members = {"0.png": PHOTO, "0.json": ABOUT, "0.depth.npy": file.getvalue()}
        with pytest.raises(InputError, match=r"a\.tar, sample 0.*numbers"):
            ShardDataset(tar_of(tmp_path / "a.tar", members))[0]

    def test_links_are_not_followed(self, tmp_path: Path):
        path = tmp_path / "a.tar"
        tar_of(path, MEMBERS)
        with tarfile.open(path, "a") as archive:
            link = tarfile.TarInfo("0.mask.png")
            link.type, link.linkname = tarfile.SYMTYPE, str(tmp_path / "secret.png")
            archive.addfile(link)
        (tmp_path / "secret.png").write_bytes(png(np.zeros((1, 2), np.uint8)))
        assert ShardDataset(path)[0].mask.all()

    @pytest.mark.parametrize(
        "damage", ["cut in a member", "cut in a header", "header", "compressed", "no tar", "empty"]
    )
    def test_damaged_shard_is_an_error_that_names_it(self, tmp_path: Path, damage: str):
        path = tar_of(tmp_path / "a.tar", {**MEMBERS, "1.png": PHOTO, "1.depth.png": DEPTH, "1.json": ABOUT})
        content = path.read_bytes()
        second = content.index(b"1.png")
        path.write_bytes({
            "cut in a member": content[: second + 550],
            "cut in a header": content[: second + 100],
            "header": content[:second] + b"?" + content[second + 1 :],
            "compressed": b"\x1f\x8b" + content,
            "no tar": b"no tar" * 1000,
            "empty": b"",
        }[damage])  # fmt: skip
        with pytest.raises(InputError, match=r"a\.tar"):
            ShardDataset(path)

    def test_header_that_promises_gigabytes_is_refused_before_they_are_read(self, tmp_path: Path):
        header = tarfile.TarInfo("long")
        header.type, header.size = tarfile.XHDTYPE, 3 * 10**9
        with (tmp_path / "a.tar").open("wb") as file:
            file.write(header.tobuf(tarfile.USTAR_FORMAT))
            file.truncate(3 * 10**9 + 2048)  # a hole: takes no room on the disk
        with pytest.raises(InputError, match="too long"):
            ShardDataset(tmp_path / "a.tar")


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


class _FolderHandler(BaseHTTPRequestHandler):
    owner: "FolderServer"

    def do_GET(self) -> None:
        self.owner.requests.append(self.path)
        path = self.owner.folder / self.path.lstrip("/")
        content = path.read_bytes() if path.is_file() else b""
        self.send_response(200 if content else 404)
        self.send_header("Content-Type", "application/octet-stream")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


class FolderServer(LocalServer):
    """The files of a folder."""

    handler = _FolderHandler

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.requests: list[str] = []
        super().__init__()


@pytest.fixture
def server(shards: Path) -> Iterator[FolderServer]:
    with FolderServer(shards) as server:
        yield server


class TestWeb:
    def test_a_shard_is_fetched_once_when_it_is_needed(self, server: FolderServer, pairs: PairDataset, tmp_path: Path):
        dataset = ShardDataset(f"{server.url}/index.json", cache=tmp_path / "cache")
        assert server.requests == ["/index.json"]
        assert same(dataset[4], pairs[4])
        assert same(dataset[3], pairs[3])
        assert same(dataset[6], pairs[6])
        again = ShardDataset(f"{server.url}/index.json", cache=tmp_path / "cache")
        assert same(again[5], pairs[5])
        assert server.requests == ["/index.json", "/pairs-000001.tar", "/pairs-000002.tar", "/index.json"]

    def test_other_shards_at_the_same_address_are_fetched_anew(
        self, server: FolderServer, shards: Path, pairs: PairDataset, tmp_path: Path
    ):
        ShardDataset(f"{server.url}/index.json", cache=tmp_path / "cache")[0]
        for path in shards.iterdir():
            path.unlink()
        other = PairDataset(write_pairs(tmp_path / "other", n=7, size=(16, 24), domain="outdoor"))
        write_shards(other, shards, name="pairs", size=THREE)
        assert same(ShardDataset(f"{server.url}/index.json", cache=tmp_path / "cache")[0], other[0])

    def test_shard_that_is_not_the_one_of_the_index_is_refused(
        self, server: FolderServer, shards: Path, tmp_path: Path
    ):
        path = shards / "pairs-000000.tar"
        content = bytearray(path.read_bytes())
        content[-1] = 1
        path.write_bytes(content)
        dataset = ShardDataset(f"{server.url}/index.json", cache=tmp_path / "cache")
        with pytest.raises(InputError, match=hashlib.sha256(content).hexdigest()):
            dataset[0]

    def test_shard_without_index(self, server: FolderServer, pairs: PairDataset, tmp_path: Path):
        dataset = ShardDataset(f"{server.url}/pairs-000000.tar", cache=tmp_path / "cache")
        assert len(dataset) == 3
        assert same(dataset[2], pairs[2])

    def test_what_is_not_there_is_an_error_that_names_the_address(
        self, server: FolderServer, shards: Path, tmp_path: Path
    ):
        with pytest.raises(InputError, match=rf"{server.url}/nowhere/index\.json"):
            ShardDataset(f"{server.url}/nowhere/index.json", cache=tmp_path / "cache")
        dataset = ShardDataset(f"{server.url}/index.json", cache=tmp_path / "cache")
        (shards / "pairs-000001.tar").unlink()
        with pytest.raises(InputError, match=rf"{server.url}/pairs-000001\.tar"):
            dataset[3]

    def test_cache_is_in_the_users_own(self, server: FolderServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
        ShardDataset(f"{server.url}/index.json")[0]
        assert [path.name for path in (tmp_path / "home" / "zoedepth" / "shards").rglob("*.tar")] == [
            "pairs-000000.tar"
        ]
