"""Files from anyone: read as tensors or refused with a message, never executed."""

import copy
import errno
import io
import json
import math
import os
import pickle
import resource
import shutil
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from tests.test_batch import fail_with
from tests.weights.layouts.layouts import same, tiny
from torch import Tensor

from zoedepth.errors import InputError
from zoedepth.weights.checkpoint import write_checkpoint
from zoedepth.weights.layouts.files import read_tensors
from zoedepth.weights.load import load_model

pytestmark = pytest.mark.filterwarnings("ignore")  # torch has some for odd files

WEIGHTS = {"a.weight": torch.arange(6.0).view(2, 3), "a.count": torch.tensor(7), "b": torch.ones(3).half()}


def torch_file(path: Path, value: Any) -> Path:
    torch.save(value, path)
    return path


@contextmanager
def little_memory(n_bytes: int = 2**30) -> Iterator[None]:
    """Inside, this process cannot take much more memory than it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + n_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


# --- what is read -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".pt", ".pth", ".bin", ".ckpt", ".safetensors", ""])
@pytest.mark.parametrize(
    "wrapped",
    [lambda weights: weights, lambda weights: {"model": weights, "optimizer": None, "epoch": 5}, OrderedDict],
    ids=["bare", "under-model", "ordered"],
)
def test_torch_file_is_read_whatever_its_suffix(tmp_path: Path, suffix: str, wrapped: Callable):
    weights, texts = read_tensors(torch_file(tmp_path / f"file{suffix}", wrapped(WEIGHTS)))
    assert same(weights, WEIGHTS)
    assert texts == {}


@pytest.mark.parametrize("suffix", [".safetensors", ".pt"])
def test_safetensors_file_is_read_with_its_texts_whatever_its_suffix(tmp_path: Path, suffix: str):
    save_file(WEIGHTS, tmp_path / f"file{suffix}", metadata={"format": "pt", "config": "{}"})
    weights, texts = read_tensors(tmp_path / f"file{suffix}")
    assert same(weights, WEIGHTS)
    assert texts == {"format": "pt", "config": "{}"}


def test_safetensors_file_that_begins_like_a_pickle_is_read(tmp_path: Path):
    """It begins with the length of its header, whose lowest byte is any multiple of eight."""
    file = tmp_path / "file.safetensors"
    for length in range(0, 256, 8):
        save_file(WEIGHTS, file, metadata={"text": "x" * length})
        if file.read_bytes()[:1] == pickle.PROTO:
            break
    assert file.read_bytes()[:1] == pickle.PROTO
    assert same(read_tensors(file)[0], WEIGHTS)


def test_prefix_of_parallel_training_is_taken_off_where_all_names_have_it(tmp_path: Path):
    wrapped = {f"module.{name}": value for name, value in WEIGHTS.items()}
    assert same(read_tensors(torch_file(tmp_path / "file.pt", {"model": wrapped}))[0], WEIGHTS)
    mixed = {"module.a": torch.ones(1), "b": torch.ones(1)}
    assert read_tensors(torch_file(tmp_path / "file.pt", mixed))[0].keys() == mixed.keys()


def test_parameters_come_out_as_plain_tensors(tmp_path: Path):
    weights, _ = read_tensors(torch_file(tmp_path / "file.pt", dict(torch.nn.Linear(2, 3).named_parameters())))
    assert [(type(value), value.requires_grad) for value in weights.values()] == [(Tensor, False)] * 2


def test_numbers_arrays_and_bytes_beside_the_weights_are_left_alone(tmp_path: Path):
    """NeWCRFs keeps its best scores so. Of an array that claims any size, nothing is made."""
    beside = {
        "steps": np.zeros(9, dtype=np.int32),
        "best": np.float64(0.1),
        "names": np.array(["a", None], dtype=object),
        "bytes": [b"\x00\xff", bytearray(b"\x00\xff")],
    }
    torch.save({"model": WEIGHTS, "huge": _Huge(), **beside}, tmp_path / "model.ckpt")
    weights, _ = read_tensors(tmp_path / "model.ckpt")
    assert weights.keys() == WEIGHTS.keys()
    torch.save({**WEIGHTS, "array": np.zeros(3)}, tmp_path / "array.pt")
    with pytest.raises(InputError, match="'array' is a _Placeholder"):
        read_tensors(tmp_path / "array.pt")


class _Huge:
    """Pickled as an array of a thousand terabytes."""

    def __reduce__(self) -> tuple:
        reconstruct = np.zeros(1).__reduce__()[0]
        return reconstruct, (np.ndarray, (10**15,), b"b")


def test_few_names_for_one_memory_are_read(tmp_path: Path):
    """The original's 24 index tables may be one."""
    weights = {"a": torch.rand(1000)} | dict.fromkeys("bcde", torch.arange(200))
    assert same(read_tensors(torch_file(tmp_path / "file.pt", weights))[0], weights)


# --- code -------------------------------------------------------------------------------------------------------------


class Trap:
    """A pickle of it makes the file ``sentinel`` when it is read."""

    def __init__(self, sentinel: Path, kind: str) -> None:
        self.call = {
            "system": (os.system, (f"touch '{sentinel}'",)),
            "touch": (Path.touch, (sentinel,)),
            "eval": (eval, (f"__import__('pathlib').Path({str(sentinel)!r}).touch()",)),
        }[kind]

    def __reduce__(self) -> tuple:
        return self.call


TRAPS = pytest.mark.parametrize("kind", ["system", "touch", "eval"])
PLACES: dict[str, Callable[[Any], Any]] = {
    "alone": lambda trap: trap,
    "weight": lambda trap: {**WEIGHTS, "trap": trap},
    "under-model": lambda trap: {"model": {**WEIGHTS, "trap": trap}},
    "beside-model": lambda trap: {"model": WEIGHTS, "optimizer": trap},
    "in-a-list": lambda trap: {"model": WEIGHTS, "optimizer": [[trap]]},
    "key": lambda trap: {trap: torch.ones(1)},
}
WRITERS: dict[str, Callable[[Any, Path], object]] = {
    "torch": torch.save,
    "torch-legacy": lambda value, path: torch.save(value, path, _use_new_zipfile_serialization=False),
    **{
        f"pickle-{protocol}": lambda value, path, protocol=protocol: path.write_bytes(pickle.dumps(value, protocol))
        for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1)
    },
}


@TRAPS
@pytest.mark.parametrize("place", PLACES)
def test_traps_would_spring(tmp_path: Path, kind: str, place: str):
    """Else the tests below prove nothing."""
    file = torch_file(tmp_path / "file.pt", PLACES[place](Trap(tmp_path / "sprung", kind)))
    torch.load(file, weights_only=False)
    assert (tmp_path / "sprung").exists()


@TRAPS
@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("suffix", [".pt", ".safetensors"])
def test_code_in_a_file_is_refused_and_not_run(tmp_path: Path, kind: str, writer: str, suffix: str):
    for place in PLACES.values():
        WRITERS[writer](place(Trap(tmp_path / "sprung", kind)), tmp_path / f"file{suffix}")
        with pytest.raises(InputError, match="refused, nothing of it was executed") as caught:
            read_tensors(tmp_path / f"file{suffix}")
        assert f"file{suffix}" in str(caught.value)
        with pytest.raises(InputError, match="refused, nothing of it was executed"):
            load_model(tmp_path / f"file{suffix}")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("protocol", [0, 1])
def test_code_in_a_pickle_without_a_mark_is_not_run(tmp_path: Path, protocol: int):
    (tmp_path / "file.pt").write_bytes(pickle.dumps(Trap(tmp_path / "sprung", "touch"), protocol))
    with pytest.raises(InputError, match=r"file.pt is not a readable"):
        read_tensors(tmp_path / "file.pt")
    assert not (tmp_path / "sprung").exists()


def test_what_the_code_is_gets_named_and_how_to_run_it_does_not(tmp_path: Path):
    """torch's own message recommends weights_only=False."""
    file = torch_file(tmp_path / "file.pt", {"a": Trap(tmp_path / "sprung", "system")})
    with pytest.raises(InputError, match=r"posix\.system") as caught:
        read_tensors(file)
    assert "weights_only" not in str(caught.value)
    assert str(caught.value).isprintable()


def test_attributes_in_a_pickle_hide_no_method_that_is_called(tmp_path: Path):
    """A tensor or dictionary may come with attributes, of any name."""

    class Dictionary:
        def __reduce__(self) -> tuple:
            attributes = dict.fromkeys(["get", "items", "keys", "values", "__len__"], 3)
            return OrderedDict, (), attributes, None, iter(weights.items())

    weights = {name: value.clone() for name, value in WEIGHTS.items()}
    for value in weights.values():
        value.numel = value.element_size = value.detach = 3
    loaded, _ = read_tensors(torch_file(tmp_path / "file.pt", Dictionary()))
    assert same(loaded, WEIGHTS)
    assert not any(vars(value) for value in loaded.values())


# --- damage -----------------------------------------------------------------------------------------------------------


SOUND = {"torch": lambda path: torch.save(WEIGHTS, path), "safetensors": lambda path: save_file(WEIGHTS, path)}


def _places(data: bytes, kind: str) -> Iterator[int]:
    """Yield the places of all bytes, but in the zeros of a file of torch, between its parts, of every tenth."""
    for place in range(len(data)):
        if kind != "torch" or place % 10 == 0 or any(data[max(0, place - 8) : place + 8]):
            yield place


@pytest.mark.parametrize("kind", SOUND)
def test_file_cut_anywhere_is_refused(tmp_path: Path, kind: str):
    file = tmp_path / "file.pt"
    SOUND[kind](file)
    data = file.read_bytes()
    for length in _places(data, kind):
        file.write_bytes(data[:length])
        with pytest.raises(InputError, match=r"file.pt"):
            read_tensors(file)


@pytest.mark.parametrize("kind", SOUND)
def test_file_with_any_byte_wrong_is_read_or_refused(tmp_path: Path, kind: str):
    file = tmp_path / "file.pt"
    SOUND[kind](file)
    data = file.read_bytes()
    outcomes = []
    for place in _places(data, kind):
        file.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        try:
            outcomes.append(all(isinstance(value, Tensor) for value in read_tensors(file)[0].values()))
        except InputError as error:
            outcomes.append(str(error))
    assert all(outcome is True or str(file) in outcome for outcome in outcomes)
    assert len(set(outcomes)) > 3


@pytest.mark.parametrize("content", [bytes(10_000_000), np.random.default_rng(0).bytes(10_000)], ids=["bomb", "random"])
def test_compressed_archive_is_refused_before_it_is_unpacked(tmp_path: Path, content: bytes):
    with zipfile.ZipFile(tmp_path / "file.pt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", pickle.dumps({}, 2))
        archive.writestr("archive/data/0", content)
    assert (tmp_path / "file.pt").stat().st_size < 100_000
    with pytest.raises(InputError, match=r"file.pt is a compressed archive"):
        read_tensors(tmp_path / "file.pt")


def test_archive_whose_entries_are_one_memory_is_refused(tmp_path: Path):
    with zipfile.ZipFile(tmp_path / "file.pt", "w") as archive:
        archive.writestr("archive/data.pkl", bytes(10_000))
        for i in range(100):
            entry = copy.copy(archive.filelist[0])
            entry.filename = f"archive/data/{i}"
            archive.filelist.append(entry)
    with pytest.raises(InputError, match="compressed"):
        read_tensors(tmp_path / "file.pt")


NOT_PLAIN: dict[str, tuple[Callable[[], Any], str]] = {
    "expanded": (lambda: {"a": torch.zeros(1).expand(1_000_000)}, "'a' claims to be larger"),
    "expanded-in-a-large-file": (
        lambda: {"a": torch.zeros(1).expand(1000), "b": torch.rand(10_000)},
        "'a' claims to be larger",
    ),
    "many-names": (lambda: dict.fromkeys(map(str, range(1000)), torch.zeros(10_000)), "claims to be larger"),
    "sparse": (lambda: {"a": torch.eye(3).to_sparse()}, "'a' is not a plain tensor"),
    "sparse-rows": (lambda: {"a": torch.eye(3).to_sparse_csr()}, "'a' is not a plain tensor"),
    "quantized": (
        lambda: {"a": torch.quantize_per_tensor(torch.ones(3), 0.1, 0, torch.qint8)},
        "'a' is not a plain tensor",
    ),
    "meta": (lambda: {"a": torch.ones(3, device="meta")}, "'a' is not a plain tensor"),
    "number-as-name": (lambda: {1: torch.ones(1)}, "'1' is a Tensor"),
    "tuple-as-name": (lambda: {("a",): torch.ones(1)}, "is not a dictionary of weights"),
    "nested": (lambda: {"state": {"a": torch.ones(1)}}, "'state' is a dict"),
    "number": (lambda: {"a": 3}, "'a' is a int"),
    "model-nested": (lambda: {"model": {"a": {"b": torch.ones(1)}}}, "'a' is a dict"),
    "empty": (dict, "holds no dictionary of weights"),
    "empty-model": (lambda: {"model": {}}, "holds no dictionary of weights"),
    "tensor": (lambda: torch.ones(1), "holds no dictionary of weights"),
    "list": (lambda: [torch.ones(1)], "holds no dictionary of weights"),
    "long-name": (lambda: {"x" * 100_000: 3}, "'x{80}' is a int"),
}


@pytest.mark.parametrize("case", NOT_PLAIN)
def test_what_is_no_dictionary_of_plain_tensors_is_refused(tmp_path: Path, case: str):
    make, message = NOT_PLAIN[case]
    with pytest.raises(InputError, match=message) as caught:
        read_tensors(torch_file(tmp_path / "file.pt", make()))
    assert "file.pt" in str(caught.value)
    assert len(str(caught.value)) < 500


def test_program_of_torch_is_refused(tmp_path: Path):
    torch.jit.trace(torch.nn.Linear(2, 2), torch.ones(1, 2)).save(str(tmp_path / "file.pt"))
    with pytest.raises(InputError, match=r"file.pt"):
        read_tensors(tmp_path / "file.pt")


def test_archive_of_something_else_is_refused(tmp_path: Path):
    with zipfile.ZipFile(tmp_path / "file.pt", "w") as archive:
        archive.writestr("photo.txt", "no photo")
    with pytest.raises(InputError, match=r"file.pt is damaged or no torch checkpoint"):
        read_tensors(tmp_path / "file.pt")


@pytest.mark.parametrize(
    "content", [b"", b"\x80", b"PK\x03\x04", b"these are no weights\n" * 100, bytes(1000)], ids=repr
)
def test_other_content_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "file.pt").write_bytes(content)
    with pytest.raises(InputError, match=r"file.pt"):
        read_tensors(tmp_path / "file.pt")


def test_folder_and_missing_file_are_named(tmp_path: Path):
    with pytest.raises(InputError, match=f"{tmp_path} cannot be read"):
        read_tensors(tmp_path)
    with pytest.raises(InputError, match=r"nothing.pt cannot be read \(No such file"):
        read_tensors(tmp_path / "nothing.pt")


def test_file_without_permission_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("{}")
    (tmp_path / "file").chmod(0)
    if os.access(tmp_path / "file", os.R_OK):  # root may read everything: the system's answer to others stands for it
        monkeypatch.setattr(Path, "open", fail_with(errno.EACCES))
    with pytest.raises(InputError, match=r"file cannot be read \(Permission"):
        read_tensors(tmp_path / "file")


# --- bombs ------------------------------------------------------------------------------------------------------------
# Small files that ask for gigabytes. The memory is limited while they are read: if they were unpacked, the message
# would be another one.


def archive(path: Path, code: bytes) -> Path:
    """A sound archive of torch whose pickle is ``code``."""
    with zipfile.ZipFile(path, "w") as target:
        target.writestr("archive/data.pkl", b"\x80\x02" + code + b".")
        target.writestr("archive/version", b"3\n")
    return path


def integer(value: int) -> bytes:
    return b"\x8a\x08" + value.to_bytes(8, "little")  # LONG1


def called(name: str, *arguments: bytes) -> bytes:
    """The code of a call of a function that torch lets any file call."""
    return f"c{name}\n".encode() + b"(" + b"".join(arguments) + b"tR"


def text(value: str) -> bytes:
    return b"X" + len(value).to_bytes(4, "little") + value.encode()


def doubled(times: int) -> bytes:
    """A text that is written as hexadecimal digits again and again."""
    code = called("_codecs\nencode", text("a" * 100), text("latin1"))
    for _ in range(times):
        code = called("_codecs\nencode", code, text("hex"))
    return code


def nested_key(depth: int) -> bytes:
    """A dictionary whose key is a pair of equal pairs of equal pairs ...: hashing it takes 2 ** depth steps."""
    code = b"}" + text("a")
    for number in range(depth):
        code += b"q" + bytes([number]) + b"h" + bytes([number]) + b"\x86"
    return code + text("value") + b"s"


BOMBS = {
    "hash": (nested_key(60), "a tuple in its keys"),
    "bytes": (called("__builtin__\nbytearray", integer(4 * 2**30)), "not in the file"),
    "tensor": (called("torch\nFloatTensor", integer(2**30)), "not in the file"),
    "storage": (called("torch\nFloatStorage", integer(2**30)), "not in the file"),
    "doubled": (doubled(30), "it encodes to 'hex'"),
    "sets": (b"\x8f" * 1_000_000, "it has a set"),
    "lists": (b"]" * 20_000_000, "bytes beside the weights"),
    "steps": (b"N0" * 990_000, "more than 700,000 pieces"),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_pickle_that_would_unpack_to_gigabytes_is_refused(tmp_path: Path, bomb: str):
    code, message = BOMBS[bomb]
    file = archive(tmp_path / "file.pt", b"}" + text("a") + code + b"s")
    with little_memory(200_000_000), pytest.raises(InputError, match=message) as caught:
        load_model(file)
    assert "file.pt" in str(caught.value)


def test_archive_of_zeros_is_refused(tmp_path: Path):
    with zipfile.ZipFile(tmp_path / "file.pt", "w", zipfile.ZIP_DEFLATED, compresslevel=9) as target:
        target.writestr("archive/data.pkl", pickle.dumps({}, 2))
        with target.open("archive/data/0", "w") as entry:
            for _ in range(30):
                entry.write(bytes(10_000_000))
    assert (tmp_path / "file.pt").stat().st_size < 400_000
    with little_memory(200_000_000), pytest.raises(InputError, match="compressed archive"):
        load_model(tmp_path / "file.pt")


def test_header_of_safetensors_that_claims_gigabytes_is_refused(tmp_path: Path):
    header = json.dumps({"a": {"dtype": "F32", "shape": [2**30], "data_offsets": [0, 2**32]}}).encode()
    (tmp_path / "file.safetensors").write_bytes(len(header).to_bytes(8, "little") + header)
    with little_memory(200_000_000), pytest.raises(InputError, match="not a readable safetensors file"):
        load_model(tmp_path / "file.safetensors")
    (tmp_path / "file.safetensors").write_bytes((2**40).to_bytes(8, "little") + header)
    with little_memory(200_000_000), pytest.raises(InputError, match="not a readable safetensors file"):
        load_model(tmp_path / "file.safetensors")


@pytest.mark.parametrize(
    "entry", ['"{}":{{"dtype":"F32","shape":[0],"data_offsets":[0,0]}}', '"{}":""'], ids=["tensors", "texts"]
)
def test_header_of_safetensors_of_megabytes_is_refused(tmp_path: Path, entry: str):
    """Half a million empty tensors in 30 MB take twenty seconds and half a gigabyte."""
    entries = ",".join(entry.format(number) for number in range(200_000))
    header = (f'{{"__metadata__":{{{entries}}}}}' if entry.endswith('""') else f"{{{entries}}}").encode()
    (tmp_path / "file.safetensors").write_bytes(len(header).to_bytes(8, "little") + header)
    with pytest.raises(InputError, match=r"file\.safetensors has a header of [\d,]+ bytes, more than 1,048,576"):
        load_model(tmp_path / "file.safetensors")


def test_config_that_would_unpack_to_gigabytes_is_refused(tmp_path: Path):
    """In the header, and beside the weights: a bracket of two bytes is a list of sixty."""
    brackets = "[" + "[]," * 10_000_000 + "[]]"
    save_file(dict(tiny().weights), tmp_path / "file.safetensors", metadata={"config": brackets})
    with little_memory(200_000_000), pytest.raises(InputError, match="has a header of"):
        load_model(tmp_path / "file.safetensors")
    folder = write_checkpoint(tiny(), tmp_path / "folder", to="huggingface")
    with (folder / "config.json").open("wb") as file:
        file.truncate(10**12)  # takes no disk
    with little_memory(200_000_000), pytest.raises(InputError, match=r"config.json"):
        load_model(folder)


# --- fuzz -------------------------------------------------------------------------------------------------------------
# Valid checkpoints, spoilt in any way: the model works, or an InputError names the file.

PIXELS = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
FUZZ = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow, HealthCheck.data_too_large]}


class Valid:
    """A checkpoint in each layout, and a place for the spoilt ones."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        checkpoint = tiny("n")
        self.original = write_checkpoint(checkpoint, folder / "original.pt", to="original")
        self.ours = write_checkpoint(checkpoint, folder / "ours.safetensors", to="zoedepth")
        self.huggingface = write_checkpoint(checkpoint, folder / "huggingface", to="huggingface")

    def copy(self, layout: str) -> tuple[Path, Path]:
        """A new copy of a layout's file or folder, and its file of weights."""
        source = getattr(self, layout)
        # Not over the one before: tensors of an example that failed may still be read from it.
        shutil.rmtree(self.folder / "spoilt", ignore_errors=True)
        target = self.folder / "spoilt" / source.name
        target.parent.mkdir()
        if source.is_dir():
            shutil.copytree(source, target)
            return target, target / "model.safetensors"
        shutil.copy(source, target)
        return target, target


LAYOUTS = st.sampled_from(["original", "ours", "huggingface"])


@pytest.fixture(scope="session")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Valid:
    return Valid(tmp_path_factory.mktemp("valid"))


def check(path: Path) -> bool:
    """Whether the file loads; it must give a working model or a message."""
    try:
        with little_memory():
            model = load_model(path)
    except InputError as error:
        text = str(error)
        assert path.name in text
        assert len(text.encode()) < 4000
        return False
    with torch.no_grad():
        depth = model(PIXELS).depth
    # A wrong bit can make a finite weight of 1e38, with which no arithmetic is finite.
    usual = all(value.abs().max() < 100 for value in model.state_dict().values() if value.numel())
    assert depth.isfinite().all() or not usual
    return True


def test_memory_is_limited():
    with little_memory(), pytest.raises(RuntimeError, match="memory"):
        torch.empty(2**31)


def test_unspoilt_files_load(valid: Valid):
    for layout in ("original", "ours", "huggingface"):
        assert check(valid.copy(layout)[0])


@st.composite
def edits(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Bytes changed, inserted, taken out and cut off; most places are near one of the ends, where the structure is."""
    places = st.one_of(st.integers(0, 40_000), st.integers(-40_000, -1), st.integers(0, 10**7))
    kinds = st.sampled_from(["flip", "flip", "set", "insert", "delete", "cut"])
    steps = draw(st.lists(st.tuples(kinds, places, st.binary(min_size=1, max_size=8)), min_size=1, max_size=6))

    def apply(data: bytes) -> bytes:
        changed = bytearray(data)
        for kind, place, new in steps:
            place = place % max(len(changed), 1)
            if kind == "flip" and changed:
                changed[place] ^= 1 << new[0] % 8
            elif kind == "set":
                changed[place : place + len(new)] = new
            elif kind == "insert":
                changed[place:place] = new
            elif kind == "delete":
                del changed[place : place + len(new)]
            elif kind == "cut":
                del changed[place:]
        return bytes(changed)

    return apply


def examples(percent: int) -> int:
    """Return a part of the number of examples that the profile has: each of these takes a tenth of a second."""
    return settings.default.max_examples * percent // 100


@settings(max_examples=examples(20), **FUZZ)
@given(layout=LAYOUTS, edit=edits(), data=st.data())
def test_fuzzed_bytes(valid: Valid, layout: str, edit: Callable[[bytes], bytes], data: st.DataObject):
    path, file = valid.copy(layout)
    if path.is_dir():
        file = path / data.draw(st.sampled_from(["model.safetensors", "config.json", "preprocessor_config.json"]))
    file.write_bytes(edit(file.read_bytes()))
    check(path)


@settings(max_examples=examples(13), **FUZZ)
@given(edit=edits())
def test_fuzzed_pickle_in_a_sound_archive(valid: Valid, edit: Callable[[bytes], bytes]):
    """The checksums of the archive are right, so that the pickle itself is read."""
    path, file = valid.copy("original")
    with zipfile.ZipFile(valid.original) as source, zipfile.ZipFile(file, "w") as target:
        for entry in source.infolist():
            data = source.read(entry)
            target.writestr(entry.filename, edit(data) if entry.filename.endswith("data.pkl") else data)
    check(path)


@settings(max_examples=examples(13), **FUZZ)
@given(layout=st.sampled_from(["ours", "huggingface"]), edit=edits(), data=st.data())
def test_fuzzed_header_of_the_right_length(
    valid: Valid, layout: str, edit: Callable[[bytes], bytes], data: st.DataObject
):
    """Of safetensors: its length is right, so that the header itself is read."""
    path, file = valid.copy(layout)
    content = file.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header = content[8 : 8 + length]
    if data.draw(st.booleans()):
        values = json.loads(header)
        entry = values[data.draw(st.sampled_from(sorted(values)))]
        entry[data.draw(st.sampled_from(sorted(entry)))] = data.draw(JSON)
        header = json.dumps(values).encode()
    else:
        header = edit(header)
    file.write_bytes(len(header).to_bytes(8, "little") + header + content[8 + length :])
    check(path)


Weights = dict[str, Tensor]
DTYPES = [
    torch.float64, torch.float16, torch.bfloat16, torch.float8_e4m3fn, torch.int64, torch.int32, torch.uint8,
    torch.bool, torch.complex64,
]  # fmt: skip


@st.composite
def changes(draw: st.DrawFn) -> Callable[[Weights], Weights]:
    """Weights renamed, exchanged, added, taken away, not finite, of other types and shapes."""
    indices = st.integers(0, 10**6)
    kinds = ["rename", "respell", "exchange", "add", "drop", "value", "dtype", "shape", "shuffle"]
    steps = draw(st.lists(st.tuples(st.sampled_from(kinds), indices, indices), min_size=1, max_size=4))
    names = st.text(st.characters(codec="utf-8"), max_size=20)
    name, number = draw(names), draw(st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e30]))
    dtype, shape = draw(st.sampled_from(DTYPES)), draw(st.lists(st.integers(0, 4), max_size=5))
    random = draw(st.randoms(use_true_random=False))

    def apply(weights: Weights) -> Weights:
        weights = dict(weights)
        for kind, first, second in steps:
            keys = sorted(weights)
            one, other = keys[first % len(keys)], keys[second % len(keys)]
            value = weights[one]
            if kind == "rename":
                weights[name] = weights.pop(one)
            elif kind == "respell":
                middle = second % (len(one) + 1)
                weights[one[:middle] + name + one[middle:]] = weights.pop(one)
            elif kind == "exchange":
                weights[one], weights[other] = weights[other], weights[one]
            elif kind == "add":
                weights[f"{one}.{name}"] = value.clone()
            elif kind == "drop":
                del weights[one]
            elif kind == "value" and value.is_floating_point() and value.numel():
                weights[one] = value.clone()
                weights[one].view(-1)[second % value.numel()] = number
            elif kind == "dtype":
                weights[one] = value.to(dtype)
            elif kind == "shape":
                weights[one] = torch.zeros(shape) if second % 2 else value.reshape(-1)
            elif kind == "shuffle":
                values = [weights[key] for key in keys]
                random.shuffle(values)
                weights = dict(zip(keys, values, strict=True))
        return weights or {name: torch.zeros(1)}

    return apply


@settings(max_examples=examples(17), **FUZZ)
@given(layout=LAYOUTS, change=changes())
def test_fuzzed_weights(valid: Valid, layout: str, change: Callable[[Weights], Weights]):
    path, file = valid.copy(layout)
    if layout == "original":
        torch.save({"model": change(torch.load(file)["model"])}, file)
    else:
        with safe_open(str(file), framework="pt") as opened:
            texts = opened.metadata()
        weights = {name: value.clone() for name, value in change(load_file(file)).items()}
        save_file(weights, file, metadata=texts)
    check(path)


WORDS = [
    "nyu", "kitti", "indoor", "outdoor", "mean", "sum", "normed", "softplus", "beit", "swin", "convolutional", "stage0",
    "beit_large_patch16_384", "resnet18", "hf-hub:owner/name", "local-dir:/", "\ud800", "\x1b[2J", "x" * 10_000, "²",
]  # fmt: skip
NUMBERS = [-1, 0, 1, 2, 4, 16, 2**31, 2**63, 10**30, 10**400, 1e30, 1e300, 0.5, -1.0, math.nan, math.inf]
LISTS = [[], [0, 1, 2, 3], [-1, 0, 1, 2], [4, 3, 2, 1], [64, 64], [0], [10**10] * 4, [f"stage{i}" for i in range(4)]]
JSON = st.one_of(
    st.sampled_from([*WORDS, *NUMBERS]),
    st.sampled_from(LISTS),
    st.recursive(
        st.one_of(st.none(), st.booleans(), st.integers(-100, 1000), st.floats(), st.text(max_size=5)),
        lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
        max_leaves=6,
    ),
)


def places(value: Any, start: tuple = ()) -> Iterator[tuple]:
    """Where in JSON there is something, from the whole to its parts."""
    if start:
        yield start
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from places(inner, (*start, key))


def put(values: Any, place: tuple, new: Any, *, drop: bool) -> None:
    *way, last = place
    for key in way:
        values = values[key]
    if drop:
        del values[last]
    else:
        values[last] = new


@settings(max_examples=examples(17), **FUZZ)
@given(source=st.sampled_from(["ours", "config.json", "preprocessor_config.json"]), data=st.data())
def test_fuzzed_config(valid: Valid, source: str, data: st.DataObject):
    path, file = valid.copy("ours" if source == "ours" else "huggingface")
    if source == "ours":
        weights = load_file(file)
        with safe_open(str(file), framework="pt") as opened:
            values = json.loads(opened.metadata()["config"])
    else:
        values = json.loads((path / source).read_text())
    for _ in range(data.draw(st.integers(1, 2))):
        place = data.draw(st.sampled_from(list(places(values))))
        put(values, place, data.draw(JSON), drop=data.draw(st.integers(0, 9)) == 0)
    if source == "ours":
        save_file(weights, file, metadata={"config": json.dumps(values)})
    else:
        (path / source).write_text(json.dumps(values))
    check(path)


@settings(max_examples=examples(5), **FUZZ)
@given(name=st.integers(0, 10**6), kind=st.sampled_from(["system", "touch", "eval"]), legacy=st.booleans())
@example(name=0, kind="touch", legacy=False)
def test_fuzzed_with_code(valid: Valid, name: int, kind: str, legacy: bool):
    path, file = valid.copy("original")
    weights = torch.load(file)["model"]
    weights[sorted(weights)[name % len(weights)]] = Trap(valid.folder / "sprung", kind)
    buffer = io.BytesIO()
    torch.save({"model": weights}, buffer, _use_new_zipfile_serialization=not legacy)
    file.write_bytes(buffer.getvalue())
    assert not check(path)
    assert not (valid.folder / "sprung").exists()
