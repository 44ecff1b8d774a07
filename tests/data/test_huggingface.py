"""Data sets of Hugging Face, saved to disk and read back by the real library. The Hub itself is not asked."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.data.huggingface import HuggingFaceDataset
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.opening import open_dataset

datasets = pytest.importorskip("datasets")

GREY = Image.new("RGB", (3, 2), (128, 128, 128))
METRES = np.array([[1.5, 0, 2.5], [np.nan, 3.5, -1]], np.float32)
KNOWN = [[1.5, 0, 2.5], [0, 3.5, 0]]
LEVELS = np.array([[1500, 0, 2500], [0, 3500, 0]], np.uint16)


def save(folder: Path, depth: list, feature: object, *, column: str = "depth_map", photo: str = "image") -> Path:
    features = datasets.Features({photo: datasets.Image(), column: feature})
    rows = {photo: [GREY] * len(depth), column: depth}
    datasets.Dataset.from_dict(rows, features=features).save_to_disk(folder)
    return folder


def tiff(values: np.ndarray) -> dict[str, object]:
    """A cell with a TIFF, as the NYU data set at the Hub has them."""
    file = io.BytesIO()
    Image.fromarray(values).save(file, "TIFF")
    return {"bytes": file.getvalue(), "path": None}


def array(height: int = 2, width: int = 3) -> object:
    return datasets.Array2D((height, width), "float32")


def test_licence_is_that_of_its_card(tmp_path: Path) -> None:
    rows = {"image": [GREY], "depth": [METRES.tolist()]}
    features = datasets.Features({"image": datasets.Image(), "depth": array()})
    info = datasets.DatasetInfo(license="cc-by-nc-4.0", features=features)
    datasets.Dataset.from_dict(rows, features=features, info=info).save_to_disk(tmp_path)
    assert open_dataset(tmp_path, domain="indoor").licence == "cc-by-nc-4.0"


@pytest.mark.parametrize("column", ["depth_map", "depth"])
@pytest.mark.parametrize("kind", ["tiff", "array", "array 3d", "lists"])
def test_floats_are_metres_in_every_form(tmp_path: Path, kind: str, column: str) -> None:
    cell, feature = {
        "tiff": (tiff(METRES), datasets.Image()),
        "array": (METRES, array()),
        "array 3d": (METRES[None], datasets.Array3D((1, 2, 3), "float32")),
        "lists": (METRES.tolist(), datasets.Sequence(datasets.Sequence(datasets.Value("float32")))),
    }[kind]
    dataset = open_dataset(save(tmp_path / "saved", [cell, cell], feature, column=column), domain="indoor")

    sample = dataset[1]

    assert len(dataset) == 2
    assert sample.target[0].tolist() == KNOWN
    assert sample.mask[0].tolist() == [[True, False, True], [False, True, False]]
    assert sample.image.shape == (3, 2, 3)
    assert sample.image.unique().tolist() == pytest.approx([128 / 255])
    assert (sample.kind, sample.domain, sample.name) == ("depth", "indoor", "00000001")
    assert (dataset.domains, dataset.kinds) == (["indoor"], ["depth"])
    assert dataset.files == [Path(tmp_path / "saved/data-00000-of-00001.arrow")], "scores are stamped with their state"
    assert dataset.licence is None


def test_whole_numbers_need_their_unit(tmp_path: Path) -> None:
    folder = save(tmp_path / "saved", [Image.fromarray(LEVELS)], datasets.Image(), photo="rgb")
    assert open_dataset(folder, domain="indoor", depth_scale=1000)[0].target[0].tolist() == KNOWN
    with pytest.raises(InputError, match=r"row 0, depth_map.*depth_scale"):
        open_dataset(folder, domain="indoor")[0]
    (folder / "dataset.json").write_text('{"depth_scale": 1000, "domain": "hall"}')
    sample = open_dataset(folder)[0]
    assert (sample.target[0].tolist(), sample.domain) == (KNOWN, "hall")


def test_floats_stay_metres_whatever_is_said_for_whole_numbers_and_far_ones_are_unknown(tmp_path: Path) -> None:
    folder = save(tmp_path / "saved", [METRES], array())
    (folder / "dataset.json").write_text('{"depth_scale": 1000, "domain": "hall", "max_depth": 3}')
    assert open_dataset(folder, depth_scale=1000)[0].target[0].tolist() == [[1.5, 0, 2.5], [0, 0, 0]]
    with pytest.raises(InputError, match=r"dataset\.json says depth_scale 1000, and 256 is asked for"):
        open_dataset(folder, depth_scale=256)


def test_splits(tmp_path: Path) -> None:
    rows = {"image": [GREY], "depth": [METRES]}
    features = datasets.Features({"image": datasets.Image(), "depth": array()})
    one, two = (datasets.Dataset.from_dict({k: v * n for k, v in rows.items()}, features=features) for n in (1, 2))
    datasets.DatasetDict({"train": two, "test": one}).save_to_disk(tmp_path / "saved")
    found = {split: len(open_dataset(tmp_path / "saved", split=split, domain="indoor")) for split in ("train", "test")}
    assert found == {"train": 2, "test": 1}
    with pytest.raises(InputError, match=r"\['test', 'train'\].*'val'"):
        open_dataset(tmp_path / "saved", split="val", domain="indoor")


def test_domain_that_nobody_says_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="domain"):
        open_dataset(save(tmp_path / "saved", [METRES], array()))


@pytest.mark.parametrize("names", [("photo", "depth"), ("image", "distance")])
def test_other_columns_are_an_error_that_names_them(tmp_path: Path, names: tuple[str, str]) -> None:
    folder = save(tmp_path / "saved", [METRES], array(), photo=names[0], column=names[1])
    with pytest.raises(InputError, match=rf"{sorted(names)[0]}.*{sorted(names)[1]}.*depth_map"):
        open_dataset(folder, domain="indoor")


def test_two_columns_that_may_be_meant_are_an_error() -> None:
    data = datasets.Dataset.from_dict(
        {"image": [GREY], "depth": [METRES], "depth_map": [METRES]},
        features=datasets.Features({"image": datasets.Image(), "depth": array(), "depth_map": array()}),
    )
    with pytest.raises(InputError, match="rows has the columns depth_map and depth: it is not clear"):
        HuggingFaceDataset(data, name="rows", domain="indoor")


@pytest.mark.parametrize("orientation", [3, 6])
def test_photo_that_exif_turns_must_show_how_depth_lies(orientation: int) -> None:
    exif, file = Image.Exif(), io.BytesIO()
    exif[0x0112] = orientation
    GREY.save(file, "JPEG", exif=exif)
    data = datasets.Dataset.from_dict(
        {"image": [{"bytes": file.getvalue(), "path": None}], "depth": [METRES]},
        features=datasets.Features({"image": datasets.Image(), "depth": array()}),
    )
    with pytest.raises(InputError, match=f"row 0, image is .*EXIF orientation {orientation}|EXIF orientation 6 turns"):
        HuggingFaceDataset(data, name="rows", domain="indoor")[0]


def test_colour_is_no_depth(tmp_path: Path) -> None:
    folder = save(tmp_path / "saved", [GREY], datasets.Image())
    with pytest.raises(InputError, match=r"row 0, depth_map.*RGB"):
        open_dataset(folder, domain="indoor", depth_scale=1)[0]


def test_lossy_depth_is_an_error(tmp_path: Path) -> None:
    file = io.BytesIO()
    Image.new("L", (3, 2)).save(file, "JPEG")
    folder = save(tmp_path / "saved", [{"bytes": file.getvalue(), "path": None}], datasets.Image())
    with pytest.raises(InputError, match="row 0, depth_map"):
        open_dataset(folder, domain="indoor", depth_scale=1)[0]


def test_sizes_that_differ_are_an_error(tmp_path: Path) -> None:
    folder = save(tmp_path / "saved", [np.ones((3, 2), np.float32)], array(3, 2))
    with pytest.raises(InputError, match=r"row 0.*\(2, 3\).*\(3, 2\)"):
        open_dataset(folder, domain="indoor")[0]


@pytest.mark.parametrize("column", ["image", "depth"])
def test_empty_cell_is_an_error_that_names_it(column: str) -> None:
    rows: dict[str, list] = {"image": [GREY], "depth": [tiff(METRES)]}
    rows[column] = [None]
    features = datasets.Features({"image": datasets.Image(), "depth": datasets.Image()})
    dataset = HuggingFaceDataset(datasets.Dataset.from_dict(rows, features=features), name="made", domain="indoor")
    with pytest.raises(InputError, match=f"made, row 0, {column}"):
        dataset[0]


def test_library_that_would_run_code_of_the_data_set_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = save(tmp_path / "saved", [METRES], array())
    monkeypatch.setattr(datasets, "__version__", "3.6.0")
    with pytest.raises(MissingExtraError, match=r"newer datasets than 3\.6\.0.*\[hf\]"):
        open_dataset(folder, domain="indoor")


def test_damaged_folder_is_an_error_that_names_it(tmp_path: Path) -> None:
    folder = save(tmp_path / "saved", [METRES], array())
    for path in folder.glob("*.arrow"):
        path.write_bytes(b"damaged")
    with pytest.raises(InputError, match="saved"):
        open_dataset(folder, domain="indoor")


class TestAddress:
    """What is asked of the library; its answer is a data set in memory."""

    @pytest.fixture
    def asked(self, monkeypatch: pytest.MonkeyPatch) -> list:
        asked = []

        def load(*arguments: object, **options: object) -> object:
            asked.append((arguments, options))
            features = datasets.Features({"image": datasets.Image(), "depth": array()})
            return datasets.Dataset.from_dict({"image": [GREY], "depth": [METRES]}, features=features)

        monkeypatch.setattr(datasets, "load_dataset", load)
        return asked

    @pytest.mark.parametrize(
        ("address", "expected"),
        [
            ("hf:owner/name", ("owner/name", None, "test", None)),
            ("hf:owner/name:validation", ("owner/name", None, "validation", None)),
            ("hf:owner/name@v1.0:train", ("owner/name", None, "train", "v1.0")),
            ("hf:owner/name:train[:100]?config=small", ("owner/name", "small", "train[:100]", None)),
        ],
    )
    def test_parts(self, asked: list, address: str, expected: tuple):
        assert open_dataset(address, split="test", domain="indoor")[0].target[0].tolist() == KNOWN
        [((repo, config), options)] = asked
        assert (repo, config, options.pop("split"), options.pop("revision")) == expected
        assert options == {}

    def test_unit_and_domain(self, asked: list):
        dataset = open_dataset("hf:owner/name?domain=hall&depth_scale=0.5")
        assert (dataset.domains, dataset[0].target[0, 0, 0].item()) == (["hall"], 3)

    @pytest.mark.parametrize(
        "address",
        [
            "hf:",
            "hf:name",
            "hf:../name/more",
            "hf:owner/name@",
            "hf:owner/name?depth=1",
            "hf:owner/name?depth_scale=mm",
        ],
    )
    def test_malformed(self, asked: list, address: str):
        with pytest.raises(InputError, match="hf:"):
            open_dataset(address, domain="indoor")
        assert asked == []

    def test_error_of_the_library_names_the_data_set(self, monkeypatch: pytest.MonkeyPatch):
        def load(*arguments: object, **options: object) -> object:
            raise ConnectionError("no route")

        monkeypatch.setattr(datasets, "load_dataset", load)
        with pytest.raises(InputError, match=r"'train' of owner/name.*no route"):
            open_dataset("hf:owner/name", domain="indoor")
