"""The work of a table: which trainings there are, and what tells their results apart."""

import dataclasses
import shutil
from pathlib import Path

import pytest
from tests.folders import write_pairs
from tests.reproduction.conftest import TABLE

from zoedepth.config import to_dict
from zoedepth.reproduction.scale import Scale, small
from zoedepth.reproduction.tables import TABLES, Table
from zoedepth.reproduction.units import _LATER, Training, Unit, _training, data_content, plan, scored_names, share


def ids(units: list[Unit]) -> list[str]:
    return [unit.training.id for unit in units if unit.training is not None]


def test_rows_are_trained_for_every_seed_after_their_own_pre_training(tiny: Scale, data: dict[str, str]) -> None:
    units = plan(TABLE, tiny, data, seeds=(3, 4))
    assert [(unit.row.name, unit.seed) for unit in units] == [
        ("Naive head", 3), ("Attractors", 3), ("Naive head", 4), ("Attractors", 4),
    ]  # fmt: skip
    starts = [unit.training.start for unit in units if unit.training is not None]
    assert all(isinstance(start, Training) for start in starts)
    bases = [start.id for start in starts if isinstance(start, Training)]
    assert bases[:2] == [bases[0]] * 2
    assert bases[2:] == [bases[2]] * 2
    assert bases[0] != bases[2]
    assert len(set(ids(units))) == 4
    assert {each.config.seed for unit in units[:2] for each in (unit.training and unit.training.chain()) or []} == {3}


def test_a_result_belongs_to_configuration_data_seed_and_start(
    tiny: Scale, data: dict[str, str], tmp_path: Path
) -> None:
    first = ids(plan(TABLE, tiny, data, seeds=(3,)))
    assert ids(plan(TABLE, tiny, data, seeds=(3,))) == first
    moved = shutil.copytree(data["nyu"], tmp_path / "moved")
    assert ids(plan(TABLE, tiny, {"nyu": str(moved)}, seeds=(3,))) == first
    longer = dataclasses.replace(tiny, adapt=lambda row: dataclasses.replace(tiny.adapt(row), steps=5))
    workers = dataclasses.replace(tiny, adapt=lambda row: dataclasses.replace(tiny.adapt(row), n_workers=4))
    write_pairs(tmp_path / "other", n=4)
    others = [
        ids(plan(TABLE, longer, data, seeds=(3,))),
        ids(plan(TABLE, tiny, data, seeds=(4,))),
        ids(plan(TABLE, tiny, {"nyu": str(tmp_path / "other")}, seeds=(3,))),
        ids(plan(TABLE, tiny, data, seeds=(3,), bases={"N": "weights.safetensors"})),
    ]
    assert len({*first, *(each for found in others for each in found)}) == 10
    assert ids(plan(TABLE, workers, data, seeds=(3,))) == first


def test_fields_that_came_later_count_where_they_are_set(tiny: Scale, data: dict[str, str]) -> None:
    """Results that are published keep their names."""
    config = to_dict(tiny.adapt(TABLE.rows[0]))
    assert {name: config[name] for name in _LATER} == _LATER
    first = ids(plan(TABLE, tiny, data, seeds=(3,)))
    held = dataclasses.replace(
        tiny, adapt=lambda row: dataclasses.replace(found := tiny.adapt(row), holdouts=(1,) * len(found.sources))
    )
    assert not set(first) & set(ids(plan(TABLE, held, data, seeds=(3,))))


def test_rows_without_their_data_are_not_run(tiny: Scale) -> None:
    units = plan(TABLE, tiny, {}, seeds=(3,))
    assert [(unit.training, unit.missing) for unit in units] == [(None, ("nyu",))] * 2


def test_shares_are_all_of_the_work_once_and_keep_a_seed_together(tiny: Scale, data: dict[str, str]) -> None:
    units = plan(TABLE, tiny, data, seeds=(3, 4, 5))
    for count in (1, 2, 3, 4, 9):
        shares = [share(units, index, count) for index in range(count)]
        assert [unit for part in shares for unit in part] == units
    assert [{unit.seed for unit in share(units, index, 3)} for index in range(3)] == [{3}, {4}, {5}]


def test_tables_are_scored_on_their_columns_and_on_what_nothing_trains_on(tiny: Scale, data: dict[str, str]) -> None:
    units = plan(TABLE, tiny, data, seeds=(3,))
    assert scored_names(TABLE, units, {**data, "kitchen": "a", "scenes": "b", "relative": "c"}) == ["nyu", "kitchen"]
    five: Table = TABLES["table-5"]
    without = [Unit(five.rows[0], 3, None, ("kitti",))]
    assert scored_names(five, without, {"nyu": "a", "kitti": "b"}) == ["nyu"]


@pytest.mark.parametrize("source", ["synthetic:rooms?n=4", "synthetic:all?n=4"])
def test_rendered_scenes_are_known_by_what_is_asked_for(source: str) -> None:
    pytest.importorskip("embreex")
    assert (
        data_content(source, "scenes") == data_content(source, "scenes") != data_content(f"{source}&seed=2", "scenes")
    )


@pytest.mark.parametrize(("table", "known"), [("table-5", "5a5371a785221eb6"), ("table-6", "0f0382da9fba190f")])
def test_published_results_keep_their_names(table: str, known: str) -> None:
    """The results in docs/reproduction are found by such hashes: a field that counts, or another recipe, loses them."""
    row = TABLES[table].rows[0]
    config = small(row)
    assert _training(row.name, config, {source.name: "" for source in config.sources}, "imagenet", {}, {}).id == known
