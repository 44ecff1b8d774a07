"""Photos from standard input, and files to standard output."""

import sys
from io import BytesIO, TextIOWrapper
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.cli import main
from zoedepth.commands.streams import standard_streams
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.stored import Memory, read_stored


@pytest.fixture
def photo(tmp_path: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a photo; every model name gives the tiny model."""
    monkeypatch.setattr("zoedepth.weights.load.load_for_prediction", lambda name, **_: tiny_model)
    pixels = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "photo.png")
    return tmp_path / "photo.png"


def feed(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", TextIOWrapper(BytesIO(content)))


@pytest.mark.parametrize("streamed", [True, False])
def test_one_file_goes_through(
    photo: Path,
    tiny_model: ZoeDepth,
    monkeypatch: pytest.MonkeyPatch,
    capsysbinary: pytest.CaptureFixture[bytes],
    streamed: bool,
) -> None:
    feed(photo.read_bytes(), monkeypatch)
    before = sorted(photo.parent.iterdir())
    expected = Predictor(tiny_model)(photo).depth
    for options, suffix, accuracy in ((["--save", "npy"], ".npy", 0), ([], ".png", 5.1e-4)):
        feed(photo.read_bytes(), monkeypatch)
        assert main(["predict", "-" if streamed else str(photo), *options, "--out", "-"]) == 0
        captured = capsysbinary.readouterr()
        stored = read_stored(Memory(captured.out, "standard output", suffix))
        np.testing.assert_allclose(stored.values / (stored.scale or 1), expected, atol=accuracy, rtol=0)
        assert b"1 of 1 photos written" in captured.err
    assert sorted(photo.parent.iterdir()) == before


def test_a_photo_that_fails_gives_nothing(
    photo: Path, monkeypatch: pytest.MonkeyPatch, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    feed(b"no picture", monkeypatch)
    assert main(["predict", "-", "--out", "-"]) == 1
    captured = capsysbinary.readouterr()
    assert captured.out == b""
    assert b"stdin is not an image" in captured.err


@pytest.mark.parametrize(
    ("sources", "out", "kinds", "json_", "message"),
    [
        (("-",), "depth", ["depth"], False, "no name"),
        (("a.jpg", "b.jpg"), "-", ["depth"], False, "one photo"),
        (("*.jpg",), "-", ["depth"], False, "one photo"),
        (("list.txt",), "-", ["depth"], False, "one photo"),
        (("two.zip",), "-", ["depth"], False, "one photo"),
        ((".",), "-", ["depth"], False, "one photo"),
        (("a.jpg",), "-", ["depth", "glb"], False, "not depth and glb: give one kind"),
        (("a.jpg",), "-", ["depth"], True, "--json"),
        (("-",), "-", ["depth"], False, "is empty"),
    ],
)
def test_what_no_stream_can_be(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    sources: tuple[str, ...],
    out: str,
    kinds: list[str],
    json_: bool,
    message: str,
) -> None:
    feed(b"", monkeypatch)
    monkeypatch.chdir(tmp_path)
    for name in ("list.txt", "two.zip"):
        (tmp_path / name).touch()
    with pytest.raises(InputError, match=message), standard_streams(sources, Path(out), kinds=kinds, json_=json_):
        pass


def test_terminal_gets_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    with (
        pytest.raises(InputError, match="terminal"),
        standard_streams(("a.jpg",), Path("-"), kinds=["depth"], json_=False),
    ):
        pass


def test_too_much_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    feed(b"1234", monkeypatch)
    monkeypatch.setattr("zoedepth.commands.streams._MAX_PHOTO", 3)
    with (
        pytest.raises(InputError, match="more than 3 bytes"),
        standard_streams(("-",), Path("-"), kinds=["depth"], json_=False),
    ):
        pass


def test_folders_are_left_as_they_are(tmp_path: Path) -> None:
    with standard_streams(("a.jpg", "b"), tmp_path, kinds=["depth", "glb"], json_=True) as given:
        assert given == (("a.jpg", "b"), tmp_path)
