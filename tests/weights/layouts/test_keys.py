import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tests.weights.layouts.layouts import same

from zoedepth.errors import InputError
from zoedepth.weights.layouts.keys import Row, Table, shown

TABLE = Table([
    Row("net.blocks.{}.index", None),
    Row(("net.blocks.{}.q.weight", "net.blocks.{}.k.weight", "net.blocks.{}.v.weight"), "encoder.{}.qkv.weight"),
    Row("net.blocks.{}.*", "encoder.{}.*"),
    Row("net.{}.{}.scale", "decoder.{}.level.{}.scale"),
    Row("head.*", "decoder.head.*"),
    Row("old.*", None),
])  # fmt: skip


def value(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


# --- there and back ---------------------------------------------------------------------------------------------------


def test_names_are_changed_and_values_are_not():
    theirs = {"head.out.bias": value(3), "net.blocks.12.norm.weight": value(2), "net.1.4.scale": value(1)}
    ours = TABLE.to_ours(theirs)
    assert ours.keys() == {"decoder.head.out.bias", "encoder.12.norm.weight", "decoder.1.level.4.scale"}
    assert ours["decoder.head.out.bias"] is theirs["head.out.bias"], "renaming copies nothing"
    assert same(TABLE.to_theirs(ours), theirs)


def test_sisters_are_joined_in_the_order_of_the_row_whatever_that_of_the_file():
    parts = {name: value(2, 4, seed=seed) for seed, name in enumerate("qkv")}
    theirs = {f"net.blocks.3.{name}.weight": parts[name] for name in "vqk"}
    ours = TABLE.to_ours(theirs)
    assert same(ours, {"encoder.3.qkv.weight": torch.cat([parts["q"], parts["k"], parts["v"]])})
    assert same(TABLE.to_theirs(ours), theirs)


@st.composite
def tables(draw: st.DrawFn) -> tuple[Table, dict[str, torch.Tensor]]:
    """A table of rows without a common name, and weights that it knows."""
    rows, weights = [], {}
    for i in range(draw(st.integers(1, 6))):
        kind = draw(st.sampled_from(["name", "number", "rest", "join"]))
        rest = draw(st.text("abc.{}*1", min_size=1, max_size=6))
        numbers = draw(st.lists(st.integers(0, 9999), min_size=1, max_size=3, unique=True))
        dtype = draw(st.sampled_from([torch.float32, torch.float16, torch.int64]))
        tensor = torch.arange(6, dtype=dtype).view(draw(st.sampled_from([(6,), (2, 3), (1, 6), (3, 2, 1)])))
        if kind == "name":
            rows.append(Row(f"their{i}.x", f"our{i}.y"))
            weights[f"their{i}.x"] = tensor
        elif kind == "number":
            rows.append(Row(f"their{i}.{{}}.x", f"our{i}.y.{{}}"))
            weights |= {f"their{i}.{n}.x": tensor + n for n in numbers}
        elif kind == "rest":
            rows.append(Row(f"their{i}.{{}}.*", f"our{i}.{{}}.*"))
            weights |= {f"their{i}.{n}.{rest}": tensor + n for n in numbers}
        else:
            parts = draw(st.permutations(["q", "k", "v"]))
            rows.append(Row(tuple(f"their{i}.{{}}.{part}" for part in parts), f"our{i}.{{}}.y"))
            weights |= {f"their{i}.{n}.{part}": tensor + ord(part) for n in numbers for part in parts}
    names = draw(st.permutations(sorted(weights)))
    return Table(draw(st.permutations(rows))), {name: weights[name] for name in names}


@given(tables())
def test_any_table_gives_back_what_it_was_given(case: tuple[Table, dict[str, torch.Tensor]]):
    table, weights = case
    ours = table.to_ours(weights)
    assert all(name.startswith("our") for name in ours)
    assert same(table.to_theirs(ours), weights)


def test_parts_of_a_split_are_contiguous():
    """safetensors takes no others."""
    for part in TABLE.to_theirs({"encoder.0.qkv.weight": value(4, 6).T}).values():
        assert part.is_contiguous()


# --- which row --------------------------------------------------------------------------------------------------------


def test_first_row_that_matches_counts():
    rows = [Row("a.b.*", "first.*"), Row("a.*", "second.*")]
    assert Table(rows).to_ours({"a.b.c": value(1)}).keys() == {"first.c"}
    assert Table(rows[::-1]).to_ours({"a.b.c": value(1)}).keys() == {"second.b.c"}


def test_known_names_without_use_are_dropped_and_do_not_come_back():
    theirs = {"net.blocks.0.index": value(1), "old.thing": value(1), "head.x": value(1)}
    assert TABLE.to_ours(theirs).keys() == {"decoder.head.x"}
    assert TABLE.to_theirs(TABLE.to_ours(theirs)).keys() == {"head.x"}


@pytest.mark.parametrize(
    "name",
    ["head", "head.", "xhead.a", "net.blocks.a.weight", "net.blocks.12345.weight", "net.blocks..weight",
     "netXblocksX1Xw", "head.a\nb", "encoder.0.norm", "decoder.head.x", ""],
)  # fmt: skip
def test_pattern_takes_whole_names_only(name: str):
    with pytest.raises(InputError, match="unknown weights"):
        TABLE.to_ours({name: value(1)})


# --- errors -----------------------------------------------------------------------------------------------------------


def test_unknown_names_are_listed_up_to_eight_and_counted():
    names = [f"strange.{i:02}" for i in range(11)]
    with pytest.raises(InputError) as caught:
        TABLE.to_ours({name: value(1) for name in reversed(names)} | {"head.x": value(1)})
    assert str(caught.value) == f"unknown weights: {', '.join(map(repr, names[:8]))} and 3 more"


def test_weight_without_a_place_in_the_other_layout_is_named():
    with pytest.raises(InputError, match=r"no place for 'router.x'$"):
        TABLE.to_theirs({"decoder.head.x": value(1), "router.x": value(1)})


def test_missing_sisters_are_named():
    with pytest.raises(InputError, match=r"missing weights: 'net.blocks.7.k.weight', 'net.blocks.7.v.weight'$"):
        TABLE.to_ours({"net.blocks.7.q.weight": value(2, 2)})


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((3, 2), torch.float32), ((2, 3), torch.float32), ((2, 2, 1), torch.float32), ((2,), torch.float32),
     ((2, 2), torch.float64), ((2, 2), torch.float8_e4m3fn)],
    ids=str,
)  # fmt: skip
def test_sisters_of_unlike_shapes_or_types_are_refused(shape: tuple[int, ...], dtype: torch.dtype):
    """Some types cannot be joined, and a join of others would change the type of some weights."""
    theirs = {f"net.blocks.0.{name}.weight": value(2, 2) for name in "qkv"}
    with pytest.raises(InputError, match=r"net.blocks.0.q.weight and its sisters"):
        TABLE.to_ours(theirs | {"net.blocks.0.v.weight": torch.zeros(shape).to(dtype)})


def test_sisters_without_axes_are_refused():
    with pytest.raises(InputError, match="sisters"):
        TABLE.to_ours({f"net.blocks.0.{name}.weight": torch.tensor(1.0) for name in "qkv"})


@pytest.mark.parametrize("shape", [(), (4,), (7, 3), (2, 3)], ids=str)
def test_weight_that_cannot_be_split_is_refused(shape: tuple[int, ...]):
    with pytest.raises(InputError, match=r"encoder.5.qkv.weight of shape .* cannot be split in 3"):
        TABLE.to_theirs({"encoder.5.qkv.weight": torch.zeros(shape)})


def test_number_without_axes_is_renamed():
    assert same(TABLE.to_theirs({"decoder.head.x": torch.tensor(3)}), {"head.x": torch.tensor(3)})


def test_second_name_of_a_weight_is_refused():
    """One of the two would be lost without a word."""
    table = Table([Row("a.*", "same.*"), Row("b.*", "same.*")])
    with pytest.raises(InputError, match=r"unknown weights: 'b.x'"):
        table.to_ours({"a.x": value(1), "b.x": value(1)})


# --- names alone ------------------------------------------------------------------------------------------------------


def test_names_in_the_other_layout():
    assert TABLE.theirs("encoder.2.norm.bias") == ("net.blocks.2.norm.bias",)
    assert TABLE.theirs("encoder.2.qkv.weight") == tuple(f"net.blocks.2.{name}.weight" for name in "qkv")
    assert TABLE.theirs("decoder.3.level.1.scale") == ("net.3.1.scale",)
    assert TABLE.theirs("router.x") == ()
    assert TABLE.theirs("old.thing") == ()


def test_long_and_unprintable_names_stay_one_line():
    text = shown(["a" * 10_000, "b\n\x1b[2J", "\ud800"])
    assert len(text) < 200
    assert text.isprintable()
    assert shown([]) == ""
    assert shown(list("cab")) == "'a', 'b', 'c'"
