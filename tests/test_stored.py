"""Depth maps, masks and small texts: read back as written, and refused where a file is damaged, lies, or is a bomb."""

import importlib.util
import json
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import bombs

import zoedepth
from zoedepth.errors import InputError
from zoedepth.images import MAX_PIXELS
from zoedepth.outputs.depth import write_depth_png
from zoedepth.stored import (
    MAX_NESTING,
    BoundedFile,
    Memory,
    declared_scale,
    parse_json,
    read_depth,
    read_hdf5,
    read_json,
    read_mask,
    read_npy,
    read_numbers,
    read_pfm,
    read_png,
    read_png_with_text,
    read_stored,
    read_text,
)

METRES = np.array([[0.5, 1.25, 0], [300.25, 2, 65.5]], np.float32)


def picture(path: Path, values: np.ndarray) -> Path:
    Image.fromarray(values).save(path)
    return path


class TestReadDepth:
    def test_is_offered_by_the_package(self) -> None:
        assert zoedepth.read_depth is read_depth

    @pytest.mark.parametrize(("dtype", "suffix"), [("f2", "npy"), ("f4", "npy"), (">f8", "npy"), ("f4", "npz")])
    def test_arrays_are_metres(self, tmp_path: Path, dtype: str, suffix: str) -> None:
        path = tmp_path / f"depth.{suffix}"
        np.save(path, METRES.astype(dtype)) if suffix == "npy" else np.savez_compressed(path, depth=METRES, other=1)
        found = read_depth(path, scale=1000)  # is for pictures of whole numbers
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, METRES)

    @pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
    def test_archives_of_many_pieces(self, tmp_path: Path, save) -> None:
        noise = np.random.default_rng(0).random((700, 900), np.float32)
        save(tmp_path / "depth.npz", depth=noise)
        np.testing.assert_array_equal(read_depth(tmp_path / "depth.npz"), noise)

    def test_whole_numbers_in_an_array_are_metres_too(self, tmp_path: Path) -> None:
        np.save(tmp_path / "depth.npy", np.array([[3, 0]], np.int64))
        assert read_depth(tmp_path / "depth.npy").tolist() == [[3, 0]]

    def test_floats_in_a_tiff_are_metres(self, tmp_path: Path) -> None:
        np.testing.assert_array_equal(read_depth(picture(tmp_path / "depth.tiff", METRES)), METRES)

    def test_levels_of_a_picture_are_divided_by_the_scale(self, tmp_path: Path) -> None:
        levels = np.array([[500, 0, 65535]], np.uint16)
        for name in ("depth.png", "depth.tif"):
            path = picture(tmp_path / name, levels)
            np.testing.assert_array_equal(read_depth(path, scale=1000), np.float32([[0.5, 0, 65.535]]))
            with pytest.raises(InputError, match=rf"{name} does not say its scale: pass scale=1000"):
                read_depth(path)

    def test_png_of_this_package_says_its_scale(self, tmp_path: Path) -> None:
        write_depth_png(tmp_path / "depth.png", np.array([[80.0]]), scale=256)
        assert read_depth(str(tmp_path / "depth.png")) == 80
        assert read_depth(tmp_path / "depth.png", scale=512) == 40

    @pytest.mark.parametrize("mode", ["L", "RGB", "P", "1"])
    def test_picture_that_is_no_depth_is_an_error(self, tmp_path: Path, mode: str) -> None:
        Image.new(mode, (2, 2)).save(tmp_path / "photo.png")
        with pytest.raises(InputError, match=r"photo\.png is not a depth map"):
            read_depth(tmp_path / "photo.png", scale=1000)

    @pytest.mark.parametrize("name", ["missing.png", "missing.npy", "missing.npz", "missing.tif", "missing.exr"])
    def test_missing_file_is_an_error_that_names_it(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError, match=rf"there is no file .*{name}"):
            read_depth(tmp_path / name)

    def test_other_suffix_is_an_error_that_lists_the_right_ones(self, tmp_path: Path) -> None:
        (tmp_path / "depth.jpg").write_bytes(b"")
        with pytest.raises(InputError, match=r"depth\.jpg: use one of \.png, \.npy"):
            read_depth(tmp_path / "depth.jpg")

    def test_archive_without_depth_is_an_error_that_says_what_it_has(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "depth.npz", metres=METRES)
        with pytest.raises(InputError, match=r"depth\.npz.*no array 'depth', but \['metres'\]"):
            read_depth(tmp_path / "depth.npz")

    def test_rubbish_is_an_error_that_names_the_file(self, tmp_path: Path) -> None:
        for suffix in (".png", ".npy", ".npz", ".tif"):
            (tmp_path / f"depth{suffix}").write_bytes(b"rubbish")
            with pytest.raises(InputError, match=rf"depth{suffix} is not a readable"):
                read_depth(tmp_path / f"depth{suffix}")


class TestReaders:
    def test_declared_scale(self, tmp_path: Path) -> None:
        write_depth_png(tmp_path / "depth.png", np.array([[80.0]]), scale=256)
        assert declared_scale(tmp_path / "depth.png") == 256
        assert declared_scale(picture(tmp_path / "bare.png", np.ones((1, 1), np.uint16))) is None
        (tmp_path / "text.png").write_text("no picture")
        assert declared_scale(tmp_path / "text.png") is None
        assert declared_scale(tmp_path / "missing.png") is None

    @pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "mm", ""])
    def test_scale_that_is_none_is_not_declared(self, tmp_path: Path, text: str) -> None:
        note = bombs.chunk(b"tEXt", b"DepthScale\0" + text.encode())
        path = picture(tmp_path / "depth.png", np.ones((1, 1), np.uint16))
        path.write_bytes(path.read_bytes()[:33] + note + path.read_bytes()[33:])
        assert declared_scale(path) is None
        assert read_stored(path).scale is None

    def test_text_of_a_png(self, tmp_path: Path) -> None:
        path = picture(tmp_path / "a.png", np.array([[7]], np.uint8))
        path.write_bytes(path.read_bytes()[:33] + bombs.chunk(b"tEXt", b"offset\0-1.5") + path.read_bytes()[33:])
        values, text = read_png_with_text(path)
        assert (values.tolist(), text) == ([[7]], {"offset": "-1.5"})

    def test_mask_may_have_one_bit_and_a_map_may_not(self, tmp_path: Path) -> None:
        path = picture(tmp_path / "mask.png", np.array([[True, False]]))
        assert read_mask(path).tolist() == [[True, False]]
        with pytest.raises(InputError, match=r"mask\.png.*mode '1'"):
            read_png(path)

    def test_maps_from_memory(self, tmp_path: Path) -> None:
        path = picture(tmp_path / "depth.png", np.array([[500]], np.uint16))
        assert read_stored(Memory(path.read_bytes(), "a.tar, sample 3", ".png")).values.tolist() == [[500]]
        with pytest.raises(InputError, match=r"a\.tar, sample 3.*not inside a shard"):
            read_stored(Memory(b"", "a.tar, sample 3", ".exr"))

    def test_pfm_is_turned_upright_in_either_byte_order(self, tmp_path: Path) -> None:
        for sign, order in (("-1.0", "<f4"), ("1.0", ">f4")):
            (tmp_path / "a.pfm").write_bytes(f"Pf\n3 2\n{sign}\n".encode() + METRES[::-1].astype(order).tobytes())
            np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), METRES)

    @pytest.mark.parametrize(
        "content", [b"", b"PF\n1 1\n-1\n" + bytes(12), b"Pf\n0 1\n-1\n", b"Pf\n1\n-1\n", b"Pf\n2 2\n-1\n"]
    )
    def test_pfm_that_is_none(self, tmp_path: Path, content: bytes) -> None:
        (tmp_path / "a.pfm").write_bytes(content)
        with pytest.raises(InputError, match=r"a\.pfm is not a readable PFM"):
            read_pfm(tmp_path / "a.pfm")

    def test_numbers(self, tmp_path: Path) -> None:
        (tmp_path / "camera.txt").write_text("1, 2.5\n-3e2\t4")
        assert read_numbers(tmp_path / "camera.txt") == [1, 2.5, -300, 4]
        (tmp_path / "camera.txt").write_text("1 two")
        with pytest.raises(InputError, match=r"camera\.txt is not a text file of numbers.*two"):
            read_numbers(tmp_path / "camera.txt")

    def test_text(self, tmp_path: Path) -> None:
        (tmp_path / "a.txt").write_text("käse", encoding="utf-8")
        assert read_text(tmp_path / "a.txt", max_bytes=5) == "käse"
        for content, word in ((b"k\xc3\xa4ses", "longer than 5 bytes"), (b"\xff", "UTF-8")):
            (tmp_path / "a.txt").write_bytes(content)
            with pytest.raises(InputError, match=rf"a\.txt.*{word}"):
                read_text(tmp_path / "a.txt", max_bytes=5)
        with pytest.raises(InputError, match=r"cannot read .*b\.txt"):
            read_text(tmp_path / "b.txt")

    def test_bounded_file_gives_what_is_asked_for_up_to_its_bound(self) -> None:
        from io import BytesIO

        file = BoundedFile(BytesIO(b"0123456789"), max_bytes=4)
        assert (file.read(4), file.read(2), file.read(), file.read(1)) == (b"0123", b"45", b"6789", b"")
        file.seek(0)
        for size in (5, -1):
            with pytest.raises(ValueError, match="more than 4 bytes"):
                file.read(size)


class TestJson:
    def test_object(self, tmp_path: Path) -> None:
        (tmp_path / "a.json").write_bytes(
            b'\xef\xbb\xbf{"a": [1, -2.5e3, true, null, "NaN"]}'
        )  # with a mark, as editors write
        assert read_json(tmp_path / "a.json") == {"a": [1, -2500, True, None, "NaN"]}

    @pytest.mark.parametrize(
        "text",
        ["", "{", "[]", "3", "null", '{"a": NaN}', '{"a": [-Infinity]}', '{"a": 1e39}', '{"a": 1e999}',
         '{"a": 1' + "0" * 50 + "}", "[" * 100_000, '{"a":' * MAX_NESTING + "1" + "}" * MAX_NESTING, b"\xff\xfe\xfd"],
        ids=lambda text: str(text)[:20],
    )  # fmt: skip
    def test_anything_else_is_an_error_that_says_where(self, text: str | bytes) -> None:
        with pytest.raises(InputError, match=r"^the file: not a JSON object"):
            parse_json(text, "the file")

    def test_brackets_as_deep_as_allowed(self) -> None:
        levels = MAX_NESTING - 1
        assert parse_json('{"a":' * levels + "1" + "}" * levels, "the file")

    def test_length(self, tmp_path: Path) -> None:
        assert parse_json('{"a": 1}', "the file", max_bytes=8) == {"a": 1}
        with pytest.raises(InputError, match="the file: longer than 7 bytes"):
            parse_json('{"a": 1}', "the file", max_bytes=7)
        with (tmp_path / "a.json").open("wb") as file:
            file.truncate(10**12)  # takes no room on the disk
        with pytest.raises(InputError, match=r"a\.json is longer than 1,048,576 bytes"):
            read_json(tmp_path / "a.json")


h5py = pytest.importorskip("h5py") if importlib.util.find_spec("h5py") else None


@pytest.mark.skipif(h5py is None, reason="needs h5py")
class TestHdf5:
    @pytest.mark.parametrize(
        "options",
        [
            {},
            {"compression": "gzip", "compression_opts": 9},
            {"compression": "gzip", "shuffle": True, "fletcher32": True, "chunks": (7, 11)},
            {"compression": "lzf", "shuffle": True},
            {"chunks": (50, 70)},
        ],
        ids=str,
    )
    @pytest.mark.parametrize("noise", [True, False])
    def test_map_is_read_however_it_is_packed(self, tmp_path: Path, options: dict, noise: bool) -> None:
        """Noise cannot be compressed, and HDF5 leaves such chunks unpacked."""
        values = np.random.default_rng(0).integers(0, 2**16, (60, 80)).astype(np.uint16)
        values = values if noise else values // 60000
        bombs.hdf5(tmp_path / "a.h5", lambda file: file.create_dataset("depth", data=values, **options))
        np.testing.assert_array_equal(read_hdf5(tmp_path / "a.h5", "depth"), values)

    def test_values_in_other_files_are_refused(self, tmp_path: Path) -> None:
        assert h5py is not None
        (tmp_path / "secret").write_bytes(bytes(400))
        bombs.hdf5(tmp_path / "other.h5", lambda file: file.create_dataset("depth", data=METRES))
        layout = h5py.VirtualLayout((2, 3), "f4")
        layout[...] = h5py.VirtualSource(str(tmp_path / "other.h5"), "depth", (2, 3))
        external = [(str(tmp_path / "secret"), 0, 400)]
        for write in (
            lambda file: file.create_dataset("depth", (10, 10), "f4", external=external),
            lambda file: file.create_virtual_dataset("depth", layout),
            lambda file: file.__setitem__("depth", h5py.ExternalLink(str(tmp_path / "other.h5"), "depth")),
        ):
            bombs.hdf5(tmp_path / "a.h5", write)
            with pytest.raises(InputError, match=r"a\.h5.*other? files?|a\.h5.*another file"):
                read_hdf5(tmp_path / "a.h5", "depth")

    @pytest.mark.parametrize("write", [
        lambda file: file.create_group("depth"),
        lambda file: file.create_dataset("other", data=METRES),
        lambda file: file.create_dataset("depth", data=METRES[None]),
        lambda file: file.create_dataset("depth", data=np.array([["a"]], "S1")),
    ], ids=["group", "no such key", "three axes", "text"])  # fmt: skip
    def test_file_without_such_a_map(self, tmp_path: Path, write) -> None:
        bombs.hdf5(tmp_path / "a.h5", write)
        with pytest.raises(InputError, match=r"a\.h5 is not an HDF5 file with a map 'depth'"):
            read_hdf5(tmp_path / "a.h5", "depth")


# ------------------------------------------------------------------------------------------------------------- bombs

# A child reads all of them: [reader, arguments] in, [message, peak of memory in MiB above that at its start] out.
CHILD = """
import json, resource, sys
from pathlib import Path
import zoedepth.stored
from zoedepth.errors import InputError
from zoedepth.images import read_image
from PIL import Image
for library in ("h5py", "OpenEXR"):
    try: __import__(library)
    except ImportError: pass
Image.init()
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))

def peak():
    if sys.platform == "linux":  # where ru_maxrss begins with the peak of the parent
        return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << (20 if sys.platform == "darwin" else 10))

start = peak()
for reader, path, *rest in json.loads(sys.argv[1]):
    read = read_image if reader == "read_image" else getattr(zoedepth.stored, reader)
    try: message = f"no error, but {type(read(Path(path), *rest))}"
    except InputError as error: message = str(error)
    print(json.dumps([message[:500], peak() - start]), flush=True)
"""


def write_bombs(folder: Path) -> list[list[str]]:
    """Write a bomb of every format; returns reader, path and further arguments of each."""
    size = 2**32 - 16
    start = bombs.npy_header((32768, 32768))
    long = b"\x93NUMPY\2\0" + b"\xff\xff\xff\xff"  # a header of 4 GiB
    files: dict[str, bytes] = {
        "zeros.npz": bombs.zip_of("depth.npy", bombs.deflated(start, bombs.GIGABYTES), size),
        "header.npz": bombs.zip_of("depth.npy", bombs.deflated(long, bombs.GIGABYTES), size),
        "entries.npz": bombs.zip_of("depth.npy", b"\3\0", 0, entries=300_000),
        "float64.npz": bombs.zip_of("depth.npy", bombs.deflated(bombs.npy_header((12000, 12000), "<f8"), 1200), 2**30),
        "claims.npy": bombs.npy_header((10**6, 10**6)),
        "cut.npy": bombs.npy_header((13000, 13000)),
        "header.npy": long + bytes(100),
        "zeros.png": bombs.png(30_000, 30_000),
        "text.png": bombs.png(8, 8, extra=bombs.chunk(b"zTXt", b"DepthScale\0\0" + bombs.zeros(1024))),
        "zeros.tif": bombs.tiff(30_000, 30_000),
        "tile.tif": bombs.tiff(8, 8, tile=(20_000, 20_000)),
        "claims.pfm": b"Pf\n1000000 1000000\n-1.0\n",
        "cut.pfm": b"Pf\n13000 13000\n-1.0\n",
    }
    for name, content in files.items():
        (folder / name).write_bytes(content)
    found = [["read_pfm" if name.endswith("pfm") else "read_depth", str(folder / name)] for name in files]
    found += [["read_mask", str(folder / "zeros.png")], ["read_png_with_text", str(folder / "text.png")],
              ["read_image", str(folder / "tile.tif")], ["read_image", str(folder / "zeros.png")]]  # fmt: skip
    if importlib.util.find_spec("OpenEXR"):
        bombs.exr(folder / "claims.exr", 30_000, 30_000)
        found.append(["read_depth", str(folder / "claims.exr")])
    if h5py is not None:

        def grow(file) -> None:
            dataset = file.create_dataset("depth", (8, 8), "f4", chunks=(8, 8), compression="gzip")
            dataset.id.write_direct_chunk((0, 0), bombs.zeros(1024))

        def large_chunk(file) -> None:
            shape, chunks = (8, 8), (16_000, 16_000)
            dataset = file.create_dataset(
                "depth", shape, "f4", chunks=chunks, maxshape=(None, None), compression="gzip"
            )
            dataset.id.write_direct_chunk((0, 0), bombs.zeros(1024))

        def filters(file) -> None:
            """A chunk of 1 MiB holds, packed twice, 1 GiB."""
            plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            plan.set_chunk((512, 512))
            plan.set_deflate(9)
            plan.set_deflate(9)
            space = h5py.h5s.create_simple((512, 512))
            dataset = h5py.h5d.create(file.id, b"depth", h5py.h5t.NATIVE_FLOAT, space, plan)
            dataset.write_direct_chunk((0, 0), zlib.compress(bombs.zeros(960)))

        def many_chunks(file) -> None:
            file.create_dataset("depth", (13_000, 13_000), "u1", chunks=(1, 1))

        def claims(file) -> None:
            file.create_dataset("depth", (10**6, 10**6), "f4", chunks=(512, 512), compression="gzip")

        for write in (grow, large_chunk, filters, many_chunks, claims):
            bombs.hdf5(folder / f"{write.__name__}.h5", write)
            found.append(["read_hdf5", str(folder / f"{write.__name__}.h5"), "depth"])
    return found


def test_bombs_of_every_format_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    pytest.importorskip("resource", reason="the operating system does not say what memory a process took")
    told = write_bombs(tmp_path)
    assert max(Path(path).stat().st_size for _, path, *_ in told) < 30_000_000
    done = subprocess.run([sys.executable, "-c", CHILD, json.dumps(told)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(answers) == len(told)
    before = 0.0
    for (reader, path, *_), (message, peak) in zip(told, answers, strict=True):
        assert path in message, f"{reader} of {Path(path).name}: {message}"
        assert peak - before < 100, f"{reader} of {Path(path).name} took {peak - before:.0f} MiB"
        before = peak
    assert before < 200


def test_map_of_as_many_pixels_as_a_photo_is_no_bomb(tmp_path: Path) -> None:
    """Only the limit is looked at: the header says how many, and nothing follows."""
    side = int(MAX_PIXELS**0.5)
    (tmp_path / "a.npy").write_bytes(bombs.npy_header((side, side)))
    with pytest.raises(InputError, match="cut short"):
        read_npy(tmp_path / "a.npy")
    (tmp_path / "a.npy").write_bytes(bombs.npy_header((side + 1, side + 1)))
    with pytest.raises(InputError, match="more than"):
        read_npy(tmp_path / "a.npy")
