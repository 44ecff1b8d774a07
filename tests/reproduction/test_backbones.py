"""The figure of backbones."""

from pathlib import Path

from PIL import Image

from zoedepth.presets import ENCODERS
from zoedepth.reproduction.backbones import IMAGENET_TOP1, plot_backbones
from zoedepth.reproduction.run import Result
from zoedepth.reproduction.scale import FULL, SMALL
from zoedepth.reproduction.tables import TABLES, rows_of
from zoedepth.reproduction.units import Training, Unit


def test_every_row_has_an_accuracy() -> None:
    table = TABLES["backbones"]
    names = {FULL.adapt(row).model.encoder_name for row in table.rows}
    names |= {SMALL.adapt(row).model.encoder_name for row in rows_of(table, small=True)}
    assert names <= IMAGENET_TOP1.keys() <= ENCODERS.keys()


def test_what_has_run_is_plotted_and_nothing_makes_no_file(tmp_path: Path) -> None:
    rows = rows_of(TABLES["backbones"], small=True)
    units = [Unit(row, 3, Training(row.name, SMALL.adapt(row), {}, "imagenet", row.name)) for row in (*rows, *rows)]
    results = [Result({"nyu": {"rel": 0.2 + 0.01 * i}}, n_parameters=(i % 3 + 4) * 10**6) for i in range(5)]
    assert not plot_backbones(units, [None] * 6, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
    assert plot_backbones(units, [*results, None], tmp_path / "some.png")
    with Image.open(tmp_path / "some.png") as picture:
        assert picture.size == (1050, 675)
