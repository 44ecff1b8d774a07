"""Read shards: in any order and process, from disk, from other programs, and from the web."""

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
from tests.folders import write_pairs
from tests.servers import LocalServer
from tests.shards.samples import ABOUT, DEPTH, MEMBERS, PHOTO, THREE, png, same, tar_of
from torch.utils.data import DataLoader

from zoedepth.data.integrity import find_broken
from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.shards.dataset import WINDOW, ShardDataset
from zoedepth.shards.index import Index
from zoedepth.shards.writer import write_shards


class TestReading:
    def test_workers_read_what_one_process_reads(self, pairs: PairDataset, shards: Path):
        dataset = ShardDataset(shards)
        dataset[0]  # its file is open when the workers begin
        loader = DataLoader(dataset, batch_size=None, num_workers=2)
        found = list(loader)
        assert len(found) == len(pairs)
        assert all(same(got, pairs[i]) for i, got in enumerate(found))

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
        assert dataset._files._opened.cache_info().currsize == 1

    def test_numbers_beyond_the_end(self, shards: Path):
        dataset = ShardDataset(shards)
        assert same(dataset[-1], dataset[6])
        with pytest.raises(IndexError):
            dataset[7]

    def test_a_unit_that_is_asked_may_not_be_another_than_that_beside_the_shards(self, shards: Path):
        (shards / "dataset.json").write_text('{"depth_scale": 1000}')
        assert len(ShardDataset(shards, depth_scale=1000)) == len(ShardDataset(shards))
        with pytest.raises(InputError, match=r"dataset\.json says depth_scale 1000, and 256 is asked for"):
            ShardDataset(shards, depth_scale=256)

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
        path = tar_of(tmp_path / "a.tar", members, format=format)
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

    def test_a_byte_that_has_changed_is_found_by_the_hash(self, shards: Path, pairs: PairDataset):
        assert ShardDataset(shards).altered() == {}
        path = sorted(shards.glob("*.tar"))[-1]
        damaged = bytearray(path.read_bytes())
        damaged[-1] ^= 1  # behind the last sample: all of them can be read as before
        path.write_bytes(damaged)
        dataset = ShardDataset(shards)
        last = list(range(len(pairs) - len(dataset.index.shards[-1]), len(pairs)))
        assert [dataset[i].name for i in last] == [pairs[i].name for i in last]
        assert find_broken(dataset) == {}
        found = find_broken(dataset, full=True)
        assert sorted(found) == last
        assert all(f"{path} is damaged, or was changed" in problem for problem in found.values())
        with pytest.raises(InputError, match=r"is damaged, or was changed: remove it, and it is written again"):
            write_shards(pairs, shards, name="pairs", size=THREE)

    def test_header_that_promises_gigabytes_is_refused_before_they_are_read(self, tmp_path: Path):
        header = tarfile.TarInfo("long")
        header.type, header.size = tarfile.XHDTYPE, 3 * 10**9
        with (tmp_path / "a.tar").open("wb") as file:
            file.write(header.tobuf(tarfile.USTAR_FORMAT))
            file.truncate(3 * 10**9 + 2048)  # a hole: takes no room on the disk
        with pytest.raises(InputError, match="too long"):
            ShardDataset(tmp_path / "a.tar")


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

    def test_shard_without_index_that_has_changed_is_fetched_anew(
        self, server: FolderServer, shards: Path, pairs: PairDataset, tmp_path: Path
    ):
        url, cache = f"{server.url}/pairs-000000.tar", tmp_path / "cache"
        assert same(ShardDataset(url, cache=cache)[0], pairs[0])
        (shards / "pairs-000002.tar").replace(shards / "pairs-000000.tar")
        for _ in range(2):
            assert same(ShardDataset(url, cache=cache)[0], pairs[6])
        server.close()
        assert same(ShardDataset(url, cache=cache)[0], pairs[6])
        assert len(list(cache.rglob("*.tar"))) == 2

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
