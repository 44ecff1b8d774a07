"""The files of a report, and the pictures of best, median and worst image."""

import json
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.evaluation.samples import EVERYWHERE, FactorSource, sample_of

import zoedepth
from zoedepth.colors import INVALID_COLOR
from zoedepth.data.sample import Sample
from zoedepth.errors import MissingExtraError
from zoedepth.evaluation import report
from zoedepth.evaluation.dataset_scores import score_dataset
from zoedepth.evaluation.out_folder import REPORTS
from zoedepth.evaluation.protocols import OUTDOOR
from zoedepth.evaluation.report import error_by_depth, examples, require_matplotlib, write_picture, write_report
from zoedepth.evaluation.summary import Summary, summarise
from zoedepth.evaluation.tables import report_tables
from zoedepth.outputs.ownership import has_own_mark

PROTOCOLS = {"indoor": EVERYWHERE}


def photos(n: int, *, size: tuple[int, int] = (60, 80)) -> list[Sample]:
    """Make photos "0.jpg", "1.jpg" ... of a slope from 1 to 9 m, whose upper tenth is unknown."""
    truth = np.linspace(1, 9, size[1]) * np.ones((size[0], 1))
    truth[: size[0] // 10] = 0
    return [sample_of(truth, name=f"{i}.jpg") for i in range(n)]


def source_of(*factors: float, broken: tuple[str, ...] = ()) -> FactorSource:
    return FactorSource({f"{i}.jpg": factor for i, factor in enumerate(factors)}, broken)


def summary_of(source: FactorSource, label: str, data: str, samples: list[Sample]) -> Summary:
    found = score_dataset(source, samples, PROTOCOLS)
    return summarise(label, data, list(found.scores.values()), PROTOCOLS, n_failed=len(found.failures))


@pytest.fixture
def summaries() -> list[Summary]:
    """Score two sources on "rooms", one of which fails once, and one on "a_b" that has a photo without truth."""
    rooms, others = photos(3), photos(2)
    others[1] = replace(others[1], mask=others[1].mask & False)
    return [
        summary_of(source_of(1.125, 1.125, 1.125), "ours", "rooms", rooms),
        summary_of(source_of(1.25, 1.25, 1.25, broken=("1.jpg",)), "theirs", "rooms", rooms),
        summary_of(source_of(1.5), "ours", "a_b", others),
    ]


# ---------------------------------------------------------------------------------------------------- files


@pytest.fixture
def written(summaries: list[Summary], tmp_path: Path) -> Path:
    found = report_tables(summaries, {})
    pictures = {"rooms": [("rooms by depth", tmp_path / "ours" / "examples.png")]}
    write_report(tmp_path, summaries, found, command="zoedepth evaluate --data rooms", pictures=pictures)
    return tmp_path


def test_report_is_four_files_and_nothing_else(written: Path) -> None:
    assert sorted(path.name for path in written.iterdir()) == sorted(REPORTS)


def test_json_has_all_numbers_under_their_protocols(written: Path, summaries: list[Summary]) -> None:
    values = json.loads((written / "report.json").read_text())
    assert values["zoedepth"] == zoedepth.__version__
    assert values["command"] == "zoedepth evaluate --data rooms"
    assert values["results"] == [summary.to_json() for summary in summaries]
    assert all(result["protocols"] == {"indoor": EVERYWHERE.label} for result in values["results"])
    assert values["results"][0]["metrics"]["rel"] == pytest.approx(0.125, abs=0.01)


def test_markdown_has_the_command_the_tables_and_the_pictures_of_each_data_set(
    written: Path, summaries: list[Summary]
) -> None:
    text = (written / "report.md").read_text()
    assert "```bash\nzoedepth evaluate --data rooms\n```" in text
    rooms, other = text.split("\n## a_b\n")
    for table in report_tables(summaries, {}):
        assert (table.markdown() in rooms, table.markdown() in other) == (
            table.title.startswith("rooms"),
            table.title.startswith("a_b"),
        )
    assert "![rooms by depth](ours/examples.png)" in rooms
    assert "![" not in other


def test_markdown_without_a_command_quotes_none(summaries: list[Summary], tmp_path: Path) -> None:
    write_report(tmp_path, summaries, report_tables(summaries, {}), command="", pictures={})
    assert "```" not in (tmp_path / "report.md").read_text()


def test_markdown_says_what_is_in_no_mean(written: Path) -> None:
    rooms, other = (written / "report.md").read_text().split("\n## a_b\n")
    assert "theirs: 0 images without a known pixel under the protocol, 1 that failed" in rooms
    assert "ours: 0" not in rooms
    assert "ours: 1 images without a known pixel under the protocol, 0 that failed" in other


def test_latex_has_all_tables(written: Path, summaries: list[Summary]) -> None:
    text = (written / "report.tex").read_text()
    assert all(table.latex() in text for table in report_tables(summaries, {}))
    assert text.count(r"\begin{table}") == 6


class Page(HTMLParser):
    """Collects the elements of a page, each with its attributes, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def test_page_has_the_tables_and_pictures_and_needs_nothing_from_elsewhere(written: Path) -> None:
    text = (written / "report.html").read_text()
    page = Page(text)
    assert [tag for tag, _ in page.elements].count("table") == 6
    assert [attributes["src"] for tag, attributes in page.elements if tag == "img"] == ["ours/examples.png"]
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.elements}
    assert "http" not in text
    assert "url(" not in text
    assert "theirs: 0 images without a known pixel under the protocol, 1 that failed" in page.text


def test_page_shows_names_and_command_as_they_are(tmp_path: Path) -> None:
    found = [summary_of(source_of(1.0), "<script>a&b</script>", '"d', photos(1))]
    pictures = {'"d': [('"<b>', tmp_path / "a b#" / "1?.png")]}
    write_report(tmp_path, found, report_tables(found, {}), command="x < 'y' BODY", pictures=pictures)
    page = Page((tmp_path / "report.html").read_text())
    assert "<script>a&b</script>" in page.text
    assert "x < 'y' BODY" in page.text
    assert page.text.count("BODY") == 1
    assert ("img", {"src": "a%20b%23/1%3F.png", "alt": '"<b>'}) in page.elements
    assert "script" not in {tag for tag, _ in page.elements}
    assert "(a%20b%23/1%3F.png)" in (tmp_path / "report.md").read_text()


def test_tables_of_a_data_set_are_not_those_of_one_whose_name_begins_alike(tmp_path: Path) -> None:
    found = [summary_of(source_of(1.0), "ours", name, photos(1)) for name in ("a", "a: b")]
    write_report(tmp_path, found, report_tables(found, {}), command="", pictures={})
    first, second = (tmp_path / "report.md").read_text().split("## a: b")
    assert (first.count("\n| source"), second.count("\n| source")) == (2, 2)


def test_letters_of_another_code_page_are_written_as_what_they_are(tmp_path: Path) -> None:
    """As they come from a command line in the C locale, and bytes that are no text at all."""
    label, broken = "zoé".encode().decode("ascii", "surrogateescape"), "\udcff"
    found = [summary_of(source_of(1.0), label, broken, photos(1))]
    write_report(tmp_path, found, report_tables(found, {}), command=f"zoedepth {label}", pictures={})
    for name in ("report.md", "report.html", "report.tex"):
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert "zoé" in text
        assert r"\xff" in text.replace("\\textbackslash{}", "\\")
    values = json.loads((tmp_path / "report.json").read_text(encoding="ascii"))
    assert values["command"] == "zoedepth zoé"
    assert (values["results"][0]["source"], values["results"][0]["data"]) == ("zoé", r"\xff")


# ---------------------------------------------------------------------------------------------------- pictures


@pytest.fixture
def panels(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, np.ndarray]]:
    """Collect (caption, picture) of the panels that are made, in their order."""
    made: list[tuple[str, np.ndarray]] = []
    real = report.panel

    def panel(image: np.ndarray, *, caption: str = "", **options: object) -> np.ndarray:
        made.append((caption, image))
        return real(image, caption=caption, **options)

    monkeypatch.setattr(report, "panel", panel)
    return made


def picture_of(source: FactorSource, samples: list[Sample]) -> np.ndarray | None:
    return examples(source, samples, score_dataset(source, samples, PROTOCOLS).scores, PROTOCOLS)


def photo_captions(panels: list[tuple[str, np.ndarray]]) -> list[str]:
    return [caption for caption, _ in panels if ".jpg" in caption]


def test_examples_are_best_median_and_worst(panels: list[tuple[str, np.ndarray]]) -> None:
    picture = picture_of(source_of(1.125, 1.0, 0.5, 1.0625, 0.75), photos(5))
    assert picture is not None
    assert (picture.ndim, picture.dtype) == (3, np.uint8)
    assert photo_captions(panels) == ["best: REL 0.000, 1.jpg", "median: REL 0.125, 0.jpg", "worst: REL 0.500, 2.jpg"]


def test_examples_are_the_photos_that_were_scored_not_those_that_failed(panels: list[tuple[str, np.ndarray]]) -> None:
    samples = photos(6)
    samples[3] = replace(samples[3], mask=samples[3].mask & False)
    assert picture_of(source_of(1, 0.5, 1, 1, 0.75, 1, broken=("0.jpg",)), samples) is not None
    assert [caption.split(", ")[1] for caption in photo_captions(panels)] == ["2.jpg", "4.jpg", "1.jpg"]


@pytest.mark.parametrize(("n", "expected"), [(1, ["0.jpg"]), (2, ["1.jpg", "0.jpg"])])
def test_fewer_than_three_photos_have_no_rank(
    panels: list[tuple[str, np.ndarray]], n: int, expected: list[str]
) -> None:
    assert picture_of(source_of(0.5, 0.75), photos(n)) is not None
    captions = photo_captions(panels)
    assert [caption.split(", ")[1] for caption in captions] == expected
    assert all(caption.startswith("REL 0.") for caption in captions)


def test_nothing_scored_has_no_picture() -> None:
    assert picture_of(FactorSource(broken=("0.jpg",)), photos(1)) is None
    assert picture_of(FactorSource(), [sample_of(np.zeros((60, 80)))]) is None


@pytest.mark.parametrize(("size", "shape"), [((60, 80), [4, 4, 4]), ((60, 160), [2] * 6)], ids=["narrow", "wide"])
def test_wide_photos_are_in_two_lines(monkeypatch: pytest.MonkeyPatch, size: tuple[int, int], shape: list[int]) -> None:
    sheets = []
    real = report.sheet
    monkeypatch.setattr(report, "sheet", lambda rows: sheets.append(rows) or real(rows))
    size = (size[0], size[1] + 1)
    picture = picture_of(source_of(1, 0.5, 0.75), photos(3, size=size))
    assert [len(row) for row in sheets[0]] == shape
    if len(shape) == 6:  # photo and prediction above each other's truth and error
        assert picture.shape[1] < 4 * 2 * size[1]  # enlarged twice, for the captions


def test_errors_are_red_where_too_far_blue_where_too_near_and_grey_where_unknown(
    panels: list[tuple[str, np.ndarray]],
) -> None:
    # Of 5 m: no clipping.
    samples = [replace(sample, target=sample.target.clamp(max=5)) for sample in photos(3)]
    picture_of(source_of(1, 1.25, 0.5), samples)
    right, far, near = (image.astype(int) for caption, image in panels if caption.startswith("error"))
    for image in (right, far, near):
        assert (image[:6] == INVALID_COLOR).all()
        assert not (image[6:] == INVALID_COLOR).all(axis=-1).any()
    assert (far[6:, :, 0] > far[6:, :, 2] + 100).all()
    assert (near[6:, :, 2] > near[6:, :, 0] + 50).all()
    assert (right[6:] == right[6, 0]).all()
    assert right[6, 0].min() > 150  # the pale middle of the colours


def test_truth_and_prediction_share_their_colours(panels: list[tuple[str, np.ndarray]]) -> None:
    picture_of(source_of(1, 0.5, 0.75), photos(3))
    measured = next(image for caption, image in panels if caption.startswith("measured"))
    predicted = next(image for caption, image in panels if caption == "predicted")
    np.testing.assert_array_equal(measured[6:], predicted[6:])
    assert (measured[:6] == INVALID_COLOR).all()
    assert len(np.unique(measured[6:].reshape(-1, 3), axis=0)) > 50


@pytest.mark.parametrize("factor", [1.0, 0.75])
def test_points_of_sparse_truth_grow_to_be_seen(panels: list[tuple[str, np.ndarray]], factor: float) -> None:
    (sample,) = photos(1)
    mask = torch.zeros_like(sample.mask)
    mask[:, 10:50:10, 10:70:10] = True
    mask[:, -1, 30] = True
    picture_of(source_of(factor), [replace(sample, mask=mask)])
    for start in ("measured", "error"):
        grown = next((image != INVALID_COLOR).any(axis=-1) for caption, image in panels if caption.startswith(start))
        # Five by five pixels each; at the lower border cut, and not at the upper again.
        assert grown.sum() == 4 * 6 * 25 + 3 * 5
        assert grown[57:, 28:33].all()


def test_photos_of_kitti_are_shown_as_they_are_scored(panels: list[tuple[str, np.ndarray]]) -> None:
    samples = [replace(sample, domain="outdoor") for sample in photos(1, size=(375, 1242))]
    source = source_of(0.75)
    protocols = {"outdoor": OUTDOOR}
    assert examples(source, samples, score_dataset(source, samples, protocols).scores, protocols) is not None
    assert panels[0][1].shape == (352, 1216, 3)


def test_picture_is_a_png(tmp_path: Path) -> None:
    picture = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    write_picture(tmp_path / "new" / "sheet.png", picture)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "new" / "sheet.png")), picture)


# ---------------------------------------------------------------------------------------------------- plot


def test_plot_is_a_png_of_all_sources(summaries: list[Summary], tmp_path: Path) -> None:
    error_by_depth(summaries[:1], tmp_path / "one.png")
    error_by_depth(summaries[:2], tmp_path / "two.png")
    one, two = (np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("one", "two"))
    assert one.shape == two.shape
    assert (one != two).any()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.png", "two.png"]
    assert has_own_mark(tmp_path / "one.png"), "it is no photo"


def test_equal_curves_are_both_seen(tmp_path: Path) -> None:
    """The one that is drawn last does not hide the other."""
    ours, other = (summary_of(source_of(1.25, 1.25), "ours", "rooms", photos(2)) for _ in range(2))
    error_by_depth([ours, replace(other, source="theirs")], tmp_path / "two.png")
    picture = np.asarray(Image.open(tmp_path / "two.png").convert("RGB")).astype(int)
    top = picture[: picture.shape[0] // 2, : picture.shape[1] // 2]  # away from the legend
    n_blue, n_orange = ((abs(top - color).sum(axis=-1) < 30).sum() for color in ((31, 119, 180), (255, 127, 14)))
    assert n_blue > 0.5 * n_orange > 100


def test_plot_of_nothing_scored_is_a_png_too(tmp_path: Path) -> None:
    nothing = summary_of(FactorSource(broken=("0.jpg",)), "ours", "rooms", photos(1))
    error_by_depth([nothing], tmp_path / "none.png")
    assert Image.open(tmp_path / "none.png").format == "PNG"


def test_missing_matplotlib_is_an_error_that_says_what_to_install(
    summaries: list[Summary], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_matplotlib()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    for attempt in (require_matplotlib, lambda: error_by_depth(summaries, tmp_path / "plot.png")):
        with pytest.raises(MissingExtraError, match=r"zoedepth\[report\]"):
            attempt()
    assert not list(tmp_path.iterdir())
