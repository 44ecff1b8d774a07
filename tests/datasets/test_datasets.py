"""The table of all data sets, in code and in the documentation."""

from pathlib import Path

import pytest

from zoedepth.cli import main
from zoedepth.datasets import DATASETS
from zoedepth.datasets.published import PublishedDataset
from zoedepth.evaluation.protocols import PROTOCOLS

DOCUMENT = Path(__file__).parents[2] / "docs" / "datasets.md"
BEGIN, END = "<!-- zoedepth data list --markdown -->\n", "<!-- end -->"


def test_documentation_is_what_the_classes_say(capsys: pytest.CaptureFixture[str]):
    """Made anew by the command at its beginning."""
    assert main(["data", "list", "--markdown"]) == 0
    text = DOCUMENT.read_text(encoding="utf-8")
    assert text.split(BEGIN)[1].split(END)[0].strip() == capsys.readouterr().out.strip()


def test_documentation_has_every_data_set():
    rows = [line for line in DOCUMENT.read_text(encoding="utf-8").splitlines() if line.startswith("| [`")]
    assert [row.split("`")[1] for row in rows] == list(DATASETS)
    for row, dataset in zip(rows, DATASETS.values(), strict=True):
        cells = [cell.strip() for cell in row.strip("|").split(" | ")]
        assert len(cells) == 7, "a bar in a fact would begin a new cell"
        assert dataset.about.page in cells[1]
        assert cells[2] == dataset.about.kind
        assert cells[6] == dataset.about.licence


def test_every_evaluation_set_of_the_paper_has_a_class_of_its_protocols_name_and_a_test_split():
    """A protocol "-released" is the released code's variant of one of the paper's data sets."""
    names = {name.removesuffix("-released") for name in PROTOCOLS if name.endswith("-released")}
    assert len(names) == 10
    assert names <= DATASETS.keys()
    for name in names:
        about = DATASETS[name].about
        assert about.kind == "depth"
        assert about.domain in ("indoor", "outdoor")
        assert about.splits["test"]


def test_every_class_of_the_folder_is_in_the_table():
    """Those that only others inherit from have no facts."""

    def below(kind: type[PublishedDataset]) -> set[type[PublishedDataset]]:
        return {kind}.union(*map(below, kind.__subclasses__()))

    own = {kind for kind in below(PublishedDataset) if kind.__module__.startswith("zoedepth.datasets.")}
    assert {kind for kind in own if hasattr(kind, "about")} == set(DATASETS.values())
    assert len(set(DATASETS.values())) == len(DATASETS)
