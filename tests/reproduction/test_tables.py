"""The rows of the paper's tables: what they differ in, and the paper's numbers beside them."""

import pytest

from zoedepth.config import to_dict
from zoedepth.errors import InputError
from zoedepth.evaluation import paper_numbers
from zoedepth.recipes import RECIPES
from zoedepth.reproduction.scale import FULL, SMALL, Scale
from zoedepth.reproduction.tables import TABLES, Row, find_table, require_known_bases, rows_of


def flat(values: object, place: str = "") -> dict[str, object]:
    """Return the leaves of plain values by their place, "model.head.n_bins"."""
    if isinstance(values, dict):
        return {k: v for key, value in values.items() for k, v in flat(value, f"{place}.{key}".strip(".")).items()}
    if isinstance(values, tuple) and any(isinstance(each, dict) for each in values):
        return {k: v for i, value in enumerate(values) for k, v in flat(value, f"{place}.{i}").items()}
    return {place: values}


def differences(rows: list[Row], scale: Scale) -> set[str]:
    """Return the places of all values in which any two rows differ."""
    configs = [flat(to_dict(scale.adapt(row))) for row in rows]
    places = set().union(*configs)
    return {place for place in places if len({repr(config.get(place)) for config in configs}) > 1}


def within(found: set[str], allowed: set[str]) -> bool:
    return all(any(place == each or place.startswith(f"{each}.") for each in allowed) for place in found)


VARIABLES = {
    "table-5": {"model.head"},
    # What a router learns from is part of what it is.
    "table-6": {"model.router.kind", "domain_weight", "route_by_label"},
    "log-binomial": {"model.head.probability"},
    "sum-or-mean": {"model.head.reduce"},
    # A Swin takes one size only, and the focal length goes with the size.
    "backbones": {"model.encoder", "model.size", "model.domains"},
}


@pytest.mark.parametrize("scale", [FULL, SMALL], ids=["full", "small"])
@pytest.mark.parametrize("name", VARIABLES)
def test_rows_of_a_table_differ_in_its_variable_alone(name: str, scale: Scale) -> None:
    rows = list(rows_of(TABLES[name], small=scale is SMALL))
    found = differences(rows, scale)
    assert found
    assert within(found, VARIABLES[name]), found
    assert {row.base for row in rows} == {"M12"}
    for one in rows:
        for other in rows:
            assert one is other or differences([one, other], scale), (one.name, other.name)


@pytest.mark.parametrize("scale", [FULL, SMALL], ids=["full", "small"])
def test_systems_on_one_base_differ_in_the_head_alone(scale: Scale) -> None:
    rows = [row for row in TABLES["table-2"].rows if row.base == "M12" and row.name.endswith("†")]
    assert len(rows) == 5
    assert within(found := differences(rows, scale), {"model.head"})
    assert found
    heads = [row for row in TABLES["table-2"].rows if row.name.startswith("ZoeD-M12")]
    assert within(found := differences(heads, scale), {"model.domains"})  # one head or two
    assert found


@pytest.mark.parametrize("scale", [FULL, SMALL], ids=["full", "small"])
def test_cells_of_the_grid_differ_in_pre_training_and_fine_tuning_alone(scale: Scale) -> None:
    rows = TABLES["grid"].rows
    fine_tunings = {row.name.rpartition("-")[2] for row in rows}
    assert fine_tunings == {"N", "K", "NK", "NK†"}
    for kind in fine_tunings:
        column = [row for row in rows if row.name.rpartition("-")[2] == kind]
        assert [row.base for row in column] == ["X", "N", "NK", "M12"]
        # A random decoder has the full rate, as released.
        allowed = {"optim.decoder_factor"} if scale is FULL and kind.startswith("NK") else set()
        assert differences(column, scale) == allowed
    for base in ("X", "N", "NK", "M12"):
        line = [row for row in rows if row.base == base]
        found = differences(line, scale)
        assert found
        assert within(found, {"model.domains", "model.size", "sources", "steps", "validate_every", "mix_by", "optim"})


def test_small_rows_are_long_enough_for_their_order_to_mean_something() -> None:
    for table in TABLES.values():
        for row in rows_of(table, small=True):
            config = SMALL.adapt(row)
            assert config.steps >= 400 * len(config.sources)
            assert config.model.size[0] >= 160
            assert config.model.size[1] >= 224
            assert config.model.encoder_name.startswith("tf_efficientnet_lite")


def test_every_row_has_a_recipe_and_a_reference() -> None:
    for table in TABLES.values():
        for small in (False, True):
            rows = rows_of(table, small=small)
            assert len({row.name for row in rows}) == len(rows)
            assert {row.recipe for row in rows} <= RECIPES.keys()
        assert table.reference in {row.name for row in table.rows}


def test_numbers_of_the_paper_stand_beside_every_row_that_it_has() -> None:
    for name in ("table-2", "table-5", "table-6", "backbones"):
        table = TABLES[name]
        known = {row.name for paper in table.paper for row in paper_numbers.tables()[paper].rows}
        assert {row.name for row in table.rows} - known <= {"the same with softmax (text)"}
    five = TABLES["table-5"]
    assert [five.printed(row, ("nyu", "rel")) for row in five.rows] == [
        "0.096", "0.085", "0.086", "0.081", "0.081", "0.080", "0.075", "0.077",
    ]  # fmt: skip
    two = TABLES["table-2"]
    assert [two.printed_mri(row, "all") for row in two.rows][-1] == "25.2"
    assert two.printed(two.rows[2], ("nyu", "rel")) == ""  # PixelBins did not converge


def test_unknown_names_are_errors_that_name_the_known() -> None:
    with pytest.raises(InputError, match="table-5"):
        find_table("table-55")
    with pytest.raises(InputError, match="M13"):
        require_known_bases({"M13": "weights"})
