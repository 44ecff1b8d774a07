"""Every source on every data set: from Python, with a folder to go on in, and in several processes."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch.distributed as distributed
from PIL import Image
from tests.evaluation.samples import EVERYWHERE, FactorSource, photo
from tests.folders import write_pairs

from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.evaluation.dataset_scores import Processes, score_dataset, score_files
from zoedepth.evaluation.evaluate import evaluate, folder_name
from zoedepth.evaluation.evaluation_set import EvaluationSet, open_evaluation_set
from zoedepth.evaluation.predictions import FolderSource
from zoedepth.evaluation.summary import summarise

DOCS = Path(__file__).parents[2] / "docs" / "evaluation.md"
PROTOCOLS = {"indoor": EVERYWHERE}
FACTORS = {f"{i}.jpg": 1 + 0.11 * i for i in range(4)}


class Photos(list[Sample]):
    """Samples that are all of rooms."""

    domains = ("indoor",)
    kinds = ("depth",)


def photos(n: int) -> Photos:
    return Photos(photo((130, 20), seed=i, name=f"{i}.jpg") for i in range(n))


def evaluation_set(n: int, **about: object) -> EvaluationSet:
    return EvaluationSet(photos(n), PROTOCOLS, about)


class NamedSource(FactorSource):
    """A source that says what its scores depend on."""

    about = {"weights": "1234"}  # noqa: RUF012 - nobody changes it


SETS = {"rooms": evaluation_set(4), "a b": evaluation_set(2)}


def test_summaries_are_set_by_set_of_all_sources() -> None:
    ours, theirs = FactorSource(FACTORS), FactorSource({"0.jpg": 1.5})
    found = evaluate({"ours": ours, "theirs": theirs}, SETS)
    expected = [
        summarise(label, name, list(score_dataset(source, each.dataset, PROTOCOLS).scores.values()), PROTOCOLS)
        for name, each in SETS.items()
        for label, source in {"ours": ours, "theirs": theirs}.items()
    ]
    assert found.summaries == expected
    assert (found.complete, found.failures, found.pictures, found.processes) == (True, [], {}, Processes())


def test_truth_that_is_hardly_in_metres_is_named() -> None:
    told: list[str] = []
    millimetres = Photos(replace(each, target=1000 * each.target) for each in photos(3))
    sets = {"rooms": evaluation_set(4), "wrong": EvaluationSet(millimetres, PROTOCOLS)}
    evaluate({"ours": FactorSource()}, sets, on_note=told.append)
    assert [note.partition(":")[0] for note in told] == ["wrong"]
    assert "the median depth of its indoor photos is" in told[0]


def test_failures_are_told_one_by_one_and_make_it_incomplete() -> None:
    told: list[str] = []
    found = evaluate({"ours": FactorSource(broken=["1.jpg"])}, SETS, on_failure=told.append)
    assert told == found.failures == ["rooms, image 1: 1.jpg is broken", "a b, image 1: 1.jpg is broken"]
    assert [(s.n_scored, s.n_failed) for s in found.summaries] == [(3, 1), (1, 1)]
    assert not found.complete
    assert evaluate({"ours": FactorSource(broken=["1.jpg"])}, SETS).failures == told  # without a callback, too


def test_photos_of_two_data_sets_may_not_share_a_depth_map(tmp_path: Path) -> None:
    sets = {
        name: open_evaluation_set(write_pairs(tmp_path / name, n=1, split="test", size=(8, 8)))
        for name in ("kitchen", "hall")
    }
    pair = sets["kitchen"].dataset
    assert isinstance(pair, PairDataset)
    maps = tmp_path / "maps"
    maps.mkdir()
    np.save(maps / f"{Path(pair.name_of(0)).stem}.npy", np.ones((8, 8), np.float32))
    with pytest.raises(InputError, match=r"would be the depth of two photos, .* of kitchen and .* of hall"):
        evaluate({"theirs": FolderSource(maps)}, sets)
    # One photo in two data sets, as under two protocols, has one map.
    twice = {"one": sets["hall"], "two": sets["hall"]}
    assert not evaluate({"theirs": FolderSource(maps)}, twice).failures


def test_depth_maps_of_photos_that_are_no_files_are_not_shared(tmp_path: Path) -> None:
    """Samples of two such sets may have the same names."""
    np.save(tmp_path / "0.npy", np.ones((130, 20), np.float32))
    with pytest.raises(InputError, match="nobody can tell the depth maps of rooms"):
        evaluate({"theirs": FolderSource(tmp_path)}, SETS)


def test_set_without_a_pixel_to_score_is_a_failure() -> None:
    nothing = EvaluationSet(photos(1), {"indoor": replace(EVERYWHERE, max_depth=0.5)})
    found = evaluate({"ours": FactorSource()}, {"far": nothing})
    assert found.failures == ["far: no image has a known pixel under its protocol"]
    assert not found.complete


def test_progress_has_the_images_and_says_of_what() -> None:
    seen = []

    def track(indices: list[int], description: str):
        seen.append((indices, description))
        yield from reversed(indices)  # which changes nothing but what is shown

    source = FactorSource()
    assert evaluate({"ours": source}, SETS, track=track).summaries == evaluate({"ours": source}, SETS).summaries
    assert seen == [([0, 1, 2, 3], "ours on rooms"), ([0, 1], "ours on a b")]
    assert source.asked == 2 * ["0.jpg", "1.jpg", "2.jpg", "3.jpg", "0.jpg", "1.jpg"]


def test_folder_has_the_scores_and_the_same_call_goes_on(tmp_path: Path) -> None:
    first = evaluate({"o/urs": FactorSource(FACTORS, broken=["2.jpg"])}, SETS, folder=tmp_path)
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.jsonl")) == [
        "o-urs/a-b/scores-0-of-1.jsonl",
        "o-urs/rooms/scores-0-of-1.jsonl",
    ]
    assert not first.complete
    source = FactorSource(FACTORS)
    found = evaluate({"o/urs": source}, SETS, folder=tmp_path)
    assert source.asked == ["2.jpg"]
    assert found.summaries == evaluate({"o/urs": FactorSource(FACTORS)}, SETS).summaries


@pytest.mark.parametrize(
    ("label", "source", "about"),
    [("ours", FactorSource(), {"data": "a.csv"}), ("ours", NamedSource(), {"data": "b.csv"})],
    ids=["other weights", "other data"],
)
def test_folder_of_something_else_is_an_error(tmp_path: Path, label: str, source, about: dict[str, object]) -> None:
    evaluate({"ours": NamedSource()}, {"rooms": evaluation_set(2, data="a.csv")}, folder=tmp_path)
    header = json.loads((tmp_path / "ours/rooms/scores-0-of-1.jsonl").read_text().splitlines()[0])
    assert header["about"] == {"source": "ours", "weights": "1234", "data": "a.csv"}
    with pytest.raises(InputError, match="Give another --out"):
        evaluate({label: source}, {"rooms": evaluation_set(2, **about)}, folder=tmp_path)


def test_report_has_tables_and_pictures(tmp_path: Path) -> None:
    sources = {"ours": FactorSource(FACTORS), "none": FactorSource(broken=[f"{i}.jpg" for i in range(4)])}
    found = evaluate(sources, SETS, folder=tmp_path, pictures=True)
    assert found.pictures == {
        "rooms": [
            ("rooms: REL by true depth", tmp_path / "rooms-error-by-depth.png"),
            ("ours: best, median and worst image by REL", tmp_path / "ours/rooms/examples.png"),
        ],
        "a b": [
            ("a b: REL by true depth", tmp_path / "a-b-error-by-depth.png"),
            ("ours: best, median and worst image by REL", tmp_path / "ours/a-b/examples.png"),
        ],
    }
    for listed in found.pictures.values():
        assert all(Image.open(path).format == "PNG" for _, path in listed)
    found.write_report(tmp_path, command="python compare.py")
    text = (tmp_path / "report.md").read_text()
    assert "python compare.py" in text
    assert "![rooms: REL by true depth](rooms-error-by-depth.png)" in text
    assert all(table.markdown() in text for table in found.tables())


def test_papers_rows_are_those_of_the_data_sets_name() -> None:
    found = evaluate({"ours": FactorSource()}, {"nyu": SETS["rooms"], "rooms": SETS["rooms"]})
    nyu, _, _, rooms, _, _ = found.tables(with_paper="all")
    assert ("Eigen et al. (paper)", "not run", "0.158", "0.641", "-", "0.769", "0.950", "0.988", "-", "") in nyu.rows
    assert len(rooms.rows) == 1
    best = found.tables(with_paper="best")[0]
    assert [row[0] for row in best.rows] == ["ours", nyu.rows[1][0]]
    assert len(found.tables()[0].rows) == 1


def test_pictures_need_a_folder_and_matplotlib_before_anything_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = FactorSource()
    with pytest.raises(InputError, match="pictures need a folder"):
        evaluate({"ours": source}, SETS, pictures=True)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"zoedepth\[report\]"):
        evaluate({"ours": source}, SETS, pictures=True, folder=tmp_path)
    assert not source.asked


def test_several_processes_need_a_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(InputError, match="--out"):
        evaluate({"ours": FactorSource()}, SETS)


def test_scores_of_the_other_processes_are_read_once_all_have_met(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sets, source = {"rooms": SETS["rooms"]}, FactorSource(FACTORS)
    expected = evaluate({"ours": source}, sets).summaries

    def other_process_ends() -> None:
        data = SETS["rooms"].dataset
        files = score_files(source, data, PROTOCOLS, tmp_path / "ours/rooms", about={"source": "ours"})
        score_dataset(source, data, PROTOCOLS, files=files, processes=Processes(1, 2))

    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setattr(distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(distributed, "barrier", other_process_ends)
    assert evaluate({"ours": source}, sets, folder=tmp_path).summaries == expected


def test_other_processes_leave_pictures_report_and_problems_of_a_set_to_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "2")
    nothing = EvaluationSet(photos(2), {"indoor": replace(EVERYWHERE, max_depth=0.5)})
    distributed.init_process_group("gloo", store=distributed.HashStore(), rank=0, world_size=1)
    try:
        found = evaluate(
            {"ours": FactorSource()}, {"rooms": SETS["rooms"], "far": nothing}, folder=tmp_path, pictures=True
        )
    finally:
        distributed.destroy_process_group()
    found.write_report(tmp_path)
    assert (found.processes, found.failures, found.pictures) == (Processes(1, 2), [], {})
    assert [(s.data, s.n_images, s.n_failed) for s in found.summaries] == [("rooms", 2, 2), ("far", 1, 1)]
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()) == [
        "ours/far/scores-1-of-2.jsonl",
        "ours/rooms/scores-1-of-2.jsonl",
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [("zoed-lite", "zoed-lite"), ("a/b c", "a-b-c"), ("../x", "x"), ("ß_1.5", "ß_1.5"), ("//", "model"), ("", "model")],
)
def test_folder_is_named_after_the_label(text: str, expected: str) -> None:
    assert folder_name(text) == expected


def test_example_of_the_documentation_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = re.findall(r"^```python\n(.*?)^```$", DOCS.read_text(encoding="utf-8"), flags=re.M | re.S)
    monkeypatch.chdir(tmp_path)
    write_pairs(tmp_path / "rooms", n=1, split="test")
    (tmp_path / "theirs").mkdir()
    names: dict[str, Any] = {}
    exec(first, names)
    output = capsys.readouterr().out
    assert "rooms, image 0: theirs has no depth of image/test_000.jpg" in output
    assert "zoed-lite rooms REL 0." in output
    assert "python compare.py" in (tmp_path / "report/report.md").read_text()
    exec(second, names)
    found = names["evaluate"]({"two metres": names["TwoMetres"]()}, names["sets"])
    assert found.complete


def test_photos_are_shown_side_by_side_and_mri_stands_in_the_report(tmp_path: Path) -> None:
    sources = {"ours": FactorSource(FACTORS), "theirs": FactorSource({"0.jpg": 1.5}, broken=["3.jpg"])}
    found = evaluate(sources, {"rooms": evaluation_set(4)}, folder=tmp_path, compare=2)
    assert found.pictures["rooms"] == [(found.pictures["rooms"][0][0], tmp_path / "rooms-compared.png")]
    with Image.open(tmp_path / "rooms-compared.png") as sheet:
        assert sheet.format == "PNG"
    found.write_report(tmp_path, reference="theirs")
    text = (tmp_path / "report.md").read_text()
    assert "rooms-compared.png" in text
    assert "## All data" in text
    assert "Mean relative improvement over theirs" in text
    with pytest.raises(InputError, match="pictures need a folder"):
        evaluate(sources, SETS, compare=1)
    with pytest.raises(InputError, match="compare is -1"):
        evaluate(sources, SETS, folder=tmp_path / "new", compare=-1)
