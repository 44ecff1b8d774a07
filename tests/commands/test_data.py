"""``zoedepth data``: the list of data sets, and what is said of a download in order and in disorder."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.datasets.base import write_photo
from tests.folders import write_csv, write_pairs

from zoedepth.cli import main
from zoedepth.commands.data import named_paths
from zoedepth.datasets import DATASETS
from zoedepth.datasets.ddad import DDAD
from zoedepth.errors import InputError


@pytest.fixture
def ddad(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of all two pairs that there are, 5 m everywhere."""
    monkeypatch.setattr(DDAD, "about", replace(DDAD.about, splits={"test": 2}))
    for number in range(2):
        write_photo(tmp_path / f"ddad/ddad_val/{number}_rgb.png", (6, 8))
        np.save(tmp_path / f"ddad/ddad_val/{number}_depth.npy", np.full((6, 8), 5.0))
    return tmp_path / "ddad"


def run(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> str:
    """What the command prints."""
    found = main(["data", *map(str, arguments)])
    output = capsys.readouterr()
    assert found == code, output.err
    return output.out


def error(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What the command says when it is told something wrong."""
    assert main(["data", *map(str, arguments)]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    return output.err


def test_list_has_every_data_set_with_its_licence_and_page(capsys: pytest.CaptureFixture[str]):
    lines = run(capsys, "list").splitlines()
    for name, dataset in DATASETS.items():
        first = next(index for index, line in enumerate(lines) if line.startswith(f"{name} "))
        title, pairs, licence, page = lines[first : first + 4]
        assert dataset.about.title in title
        assert dataset.about.kind in pairs
        assert dataset.about.licence in licence
        assert page.strip() == dataset.about.page
    assert max(len(line) for line in lines if "://" not in line) <= 80


def test_list_as_json(capsys: pytest.CaptureFixture[str]):
    records = [json.loads(line) for line in run(capsys, "list", "--json").splitlines()]
    assert [record["name"] for record in records] == list(DATASETS)
    (kitti,) = [record for record in records if record["name"] == "kitti"]
    assert (kitti["kind"], kitti["domain"], kitti["splits"]) == ("depth", "outdoor", {"train": 23158, "test": 697})


def test_a_download_in_order(ddad: Path, capsys: pytest.CaptureFixture[str]):
    output = run(capsys, "check", "ddad", ddad)
    for text in ("2 of 2 published", "8 x 6 (2)", "5 to 5 m", "100.0%", "CC BY-NC-SA 4.0", DDAD.about.page):
        assert text in output
    assert output.endswith("In order.\n")


def test_a_download_as_json(ddad: Path, capsys: pytest.CaptureFixture[str]):
    record = json.loads(run(capsys, "check", "ddad", ddad, "--json"))
    assert (record["title"], record["path"], record["split"]) == ("DDAD", str(ddad), "test")
    assert (record["pairs"], record["published"], record["read"], record["missing"]) == (2, 2, 2, 0)
    assert record["photo_sizes"] == [{"height": 6, "width": 8, "photos": 2}]
    assert record["values"] == {"least": 5, "low": 5, "median": 5, "high": 5, "greatest": 5}
    assert record["problems"] == []


def test_a_download_in_disorder(ddad: Path, capsys: pytest.CaptureFixture[str]):
    (ddad / "ddad_val/0_depth.npy").unlink()
    (ddad / "ddad_val/1_rgb.png").write_bytes(b"cut short")
    output = run(capsys, "check", "ddad", ddad, code=1)
    assert f"missing: {ddad}/ddad_val/0_depth.npy" in output
    assert f"unreadable: {ddad}/ddad_val/1_rgb.png" in output
    assert "Not in order: 1 files are missing; 1 of 1 pairs cannot be read; no pixel of any pair" in output
    assert f"Get it at {DDAD.about.page}" in output
    record = json.loads(run(capsys, "check", "ddad", ddad, "--json", code=1))
    assert record["missing_files"] == [str(ddad / "ddad_val/0_depth.npy")]
    assert len(record["unreadable"]) == 1


def test_pickled_depth_is_unreadable_and_not_run(ddad: Path, capsys: pytest.CaptureFixture[str]):
    np.save(ddad / "ddad_val/0_depth.npy", np.array([[{}]]), allow_pickle=True)
    assert "0_depth.npy is not a readable .npy" in run(capsys, "check", "ddad", ddad, code=1)


def test_many_missing_files_are_named_in_part(ddad: Path, capsys: pytest.CaptureFixture[str]):
    for number in range(2, 14):
        write_photo(ddad / f"ddad_val/{number}_rgb.png", (6, 8))
    output = run(capsys, "check", "ddad", ddad, code=1)
    assert output.count("missing: ") == 11
    assert "missing: and 2 more" in output


def test_every_pair_is_read_if_asked_for(ddad: Path, capsys: pytest.CaptureFixture[str]):
    for number in range(2, 60):
        write_photo(ddad / f"ddad_val/{number}_rgb.png", (2, 2))
        np.save(ddad / f"ddad_val/{number}_depth.npy", np.ones((2, 2)))
    assert json.loads(run(capsys, "check", "ddad", ddad, "--json"))["read"] == 50
    for option in ("--full", "--every"):  # the second is the older word
        assert json.loads(run(capsys, "check", "ddad", ddad, "--json", option))["read"] == 60


def test_sheet_is_a_picture(ddad: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert "Picture" not in run(capsys, "check", "ddad", ddad, "--sheet", tmp_path / "out/sheet.png")
    with Image.open(tmp_path / "out/sheet.png") as picture:
        assert picture.width > 4 * 400


def test_no_sheet_of_nothing(ddad: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for path in ddad.glob("ddad_val/*.npy"):
        path.unlink()
    run(capsys, "check", "ddad", ddad, "--sheet", tmp_path / "sheet.png", code=1)
    assert not (tmp_path / "sheet.png").exists()


def test_pairs_of_ones_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_pairs(tmp_path, n=2, size=(8, 16), split="train")
    write_pairs(tmp_path, n=3, size=(8, 16), split="test")
    assert json.loads(run(capsys, "check", tmp_path, "--json"))["pairs"] == 2
    assert json.loads(run(capsys, "check", tmp_path, "--split", "test", "--json"))["pairs"] == 3
    record = json.loads(run(capsys, "check", tmp_path / "test.csv", "--json"))
    assert (record["pairs"], record["path"]) == (3, str(tmp_path / "test.csv"))
    assert "In order." in run(capsys, "check", tmp_path)


def test_all_missing_files_of_ones_own_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_pairs(tmp_path, n=15, size=(8, 16))
    missing = [tmp_path / f"image/train_{index:03d}.jpg" for index in range(12)]
    for path in missing:
        path.unlink()
    output = run(capsys, "check", tmp_path, code=1)
    assert [output.count("missing: "), "missing: and 2 more, which --json lists" in output] == [11, True]
    assert "Not in order: 12 files are missing" in output
    record = json.loads(run(capsys, "check", tmp_path, "--json", code=1))
    assert record["missing_files"] == [str(path) for path in missing]
    assert (record["missing"], record["read"]) == (12, 3)


def test_a_file_that_is_cut_short_is_found_among_many(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_pairs(tmp_path, n=1, size=(8, 16))
    row = {"image": "image/train_000.jpg", "depth": "depth/train_000.png", "depth_scale": 1000, "domain": "indoor"}
    (tmp_path / "cut.jpg").write_bytes((tmp_path / row["image"]).read_bytes()[:300])
    rows = [row] * 70
    rows[33] = {**row, "image": "cut.jpg"}  # of 70, 50 are read
    output = run(capsys, "check", write_csv(tmp_path / "list.csv", rows), code=1)
    assert f"unreadable: {tmp_path}/cut.jpg" in output
    assert "Not in order: 1 of 70 pairs cannot be read." in output


def test_depth_in_a_wrong_unit_is_not_in_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_pairs(tmp_path, n=4, size=(32, 48))
    (tmp_path / "train.csv").unlink()
    (tmp_path / "dataset.json").write_text('{"domain": "indoor", "depth_scale": 100}')
    output = run(capsys, "check", tmp_path, code=1)
    assert "implausible: the median depth of its indoor photos is 2" in output
    assert output.endswith("Not in order: its depth is not plausible.\n")
    (problem,) = json.loads(run(capsys, "check", tmp_path, "--json", code=1))["problems"]
    assert "where 0.2 to 20 m are usual: is the unit right?" in problem
    (tmp_path / "dataset.json").write_text('{"domain": "indoor"}')
    assert "In order." in run(capsys, "check", tmp_path, "--depth-scale", "1000")


def test_shards_and_scenes_are_checked_as_everything_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run(capsys, "shard", write_pairs(tmp_path / "pairs", n=2, size=(32, 48)), tmp_path / "shards")
    for source in (tmp_path / "shards", tmp_path / "shards/index.json", tmp_path / "shards/data-000000.tar"):
        record = json.loads(run(capsys, "check", source, "--json"))
        assert (record["pairs"], record["read"], record["path"]) == (2, 2, str(source))
    scenes = "synthetic:rooms?n=1&size=32x48"
    assert json.loads(run(capsys, "check", scenes, "--json"))["path"] == scenes


def test_a_sheet_that_cannot_be_written_is_an_error_before_anything_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").write_text("")
    assert "--sheet" in error(capsys, "check", tmp_path / "nowhere", "--sheet", tmp_path / "file/sheet.jpg")
    Image.new("RGB", (4, 4)).save(tmp_path / "mine.jpg")
    assert "is not from zoedepth" in error(capsys, "check", tmp_path / "nowhere", "--sheet", tmp_path / "mine.jpg")


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["check", "ddad", "."], "there is no ddad_val/*_rgb.png"),
        (["check", "ddad", "nowhere"], "nowhere is not a folder"),
        (["check", "ddad", ".", "--split", "train"], "no split 'train'; it has ['test']"),
        (["check", "dada", "."], "there is no published data set 'dada': did you mean ddad?"),
        (["check", "ddad"], "say where ddad is: zoedepth data check ddad FOLDER"),
        (["check", "nowhere.csv"], "nowhere.csv"),
        (["check", "nowhere.csv", "--sheet", "sheet.gif"], "must end in one of .jpg"),
    ],
)
def test_what_cannot_be_checked_is_an_error(
    arguments: list[str],
    problem: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert problem in error(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_without_a_sub_command_is_an_error_that_lists_them(capsys: pytest.CaptureFixture[str]):
    assert main(["data"]) == 2
    assert "check" in capsys.readouterr().err


def test_list_away_from_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = write_pairs(tmp_path / "pairs", n=2, size=(8, 12))
    moved = path.rename(tmp_path / "moved.csv")
    assert "In order" in run(capsys, "check", moved, "--root", tmp_path / "pairs")
    run(capsys, "shard", moved, tmp_path / "shards", "--root", tmp_path / "pairs")
    assert "In order" in run(capsys, "check", tmp_path / "shards")


def test_named_paths(tmp_path: Path):
    assert named_paths(["a=b/c.csv", "data/nyu", "data/kitti/test.csv"]) == {
        "a": Path("b/c.csv"),
        "nyu": Path("data/nyu"),
        "kitti": Path("data/kitti/test.csv"),
    }
    assert named_paths(["data/kitti/train.TSV"]) == {"kitti": Path("data/kitti/train.TSV")}
    (tmp_path / "rate=0.1").mkdir()
    assert named_paths([str(tmp_path / "rate=0.1")]) == {"rate=0.1": tmp_path / "rate=0.1"}
    for values in (["a=b", "a=c"], ["=b"], ["a="]):
        with pytest.raises(InputError, match="each name once"):
            named_paths(values)
