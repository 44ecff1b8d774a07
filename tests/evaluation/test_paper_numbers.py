"""The paper's numbers: spot checks typed from the paper, and that the tables agree with themselves and each other."""

import dataclasses
from collections import defaultdict
from decimal import Decimal

import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.paper_numbers import datasets, method_rows, metrics, models, numbers, parameters, tables
from zoedepth.evaluation.protocols import PROTOCOLS
from zoedepth.metrics import HIGHER_IS_BETTER, Metrics
from zoedepth.presets import PRESETS

FIELDS = {field.name for field in dataclasses.fields(Metrics)}
ZERO_SHOT = ["sunrgbd", "ibims", "diode-indoor", "hypersim", "vkitti2", "ddad", "diml-outdoor", "diode-outdoor"]


def row(table: str, name: str, dataset: str) -> dict[str, str]:
    """Return a row of a table on one data set, its numbers as printed."""
    (found,) = [each for each in tables()[table].rows if each.name == name]
    return {metric: str(value) for (data, metric), value in found.values.items() if data == dataset}


def test_every_table_has_all_its_rows() -> None:
    counts = {name: len(table.rows) for name, table in tables().items()}
    assert counts == {
        "table-1": 17,
        "table-2": 11,
        "table-3": 7,
        "table-4": 7,
        "table-5": 7,
        "table-6": 3,
        **{f"{name}-full": 8 for name in ZERO_SHOT},
        "nyu-backbones": 10,
    }
    assert (len(datasets()), len(models()), len(parameters())) == (10, 12, 19)


def test_columns_are_our_data_sets_and_metrics() -> None:
    for table in tables().values():
        assert len(set(table.columns)) == len(table.columns)
        for each in table.rows:
            assert {data for data, _ in each.values} <= datasets().keys()
            assert {metric for _, metric in each.values} <= FIELDS & metrics().keys()
    assert {metric.name for metric in metrics().values()} - FIELDS == {"mri_datasets", "mri_metrics"}
    assert {name for name in metrics() if metrics()[name].higher_is_better} & FIELDS == HIGHER_IS_BETTER


@pytest.mark.parametrize(
    ("table", "name", "dataset", "printed"),
    [
        ("table-1", "Eigen et al.", "nyu", "0.769 0.950 0.988 0.158 0.641 None"),
        ("table-1", "ZoeD-M12-N", "nyu", "0.955 0.995 0.999 0.075 0.270 0.032"),
        ("table-2", "PixelBins-X-NK†", "kitti", "None"),
        ("table-2", "NeWCRFs-X-NK†", "vkitti2", "0.190"),
        ("table-2", "ZoeD-M12-NK†", "ibims", "0.210"),
        ("table-2", "ZoeD-M12-NK", "ibims", "0.186"),
        ("table-3", "ZoeD-X-N", "hypersim", "0.284 0.421 5.889"),
        ("table-4", "LocalBins", "diode-outdoor", "0.170 0.821 10.27"),
        ("table-5", "Metric bins, Splitter, factor = 2", "nyu", "0.085 0.301"),
        ("table-6", "Auto Router", "kitti", "0.075 2.584"),
        ("sunrgbd-full", "NeWCRF", "sunrgbd", "0.798 0.967 0.992 0.151 0.424 0.064"),
        ("ibims-full", "ZoeD-NK-N", "ibims", "0.671 0.939 0.983 0.172 0.735 0.084"),
        ("diode-indoor-full", "ZoeD-M12-NK", "diode-indoor", "0.386 0.695 0.807 0.331 1.598 0.185"),
        ("hypersim-full", "BTS", "hypersim", "0.225 0.419 0.582 0.476 6.404 0.329"),
        ("vkitti2-full", "AdaBins", "vkitti2", "0.826 0.947 0.98 0.122 5.42 0.057"),
        ("ddad-full", "ZoeD-M12-K", "ddad", "0.835 0.962 0.988 0.129 7.108 0.060"),
        ("diml-outdoor-full", "ZoeD-NK-K", "diml-outdoor", "0.004 0.012 0.047 2.068 7.432 0.473"),
        ("diode-outdoor-full", "LocalBins", "diode-outdoor", "0.170 0.336 0.531 0.821 10.273 0.329"),
        ("nyu-backbones", "ZoeD-M12-N (S2-T)", "nyu", "0.899 0.982 0.995 0.106 0.371 0.045"),
    ],
)
def test_rows_typed_from_the_paper(table: str, name: str, dataset: str, printed: str) -> None:
    """All numbers of a row on a data set, in the order and with the digits of the paper."""
    assert list(row(table, name, dataset).values()) == printed.split()


def test_mean_relative_improvements_typed_from_the_paper() -> None:
    rows = {(name, each.name): each.mri for name, table in tables().items() for each in table.rows}
    assert rows["table-2", "ZoeD-M12-NK"] == {"all": Decimal("25.2")}
    assert rows["table-2", "PixelBins-X-NK†"] == {"all": None}
    found = {name: str(value) for name, value in rows["table-4", "ZoeD-M12-NK"].items()}
    assert found == {"vkitti2": "7.8", "ddad": "-12.8", "diml-outdoor": "976.4", "diode-outdoor": "15.8"}
    assert rows["table-1", "ZoeD-M12-NK"] == {}


def test_thresholds_are_shares_that_grow() -> None:
    for table in tables().values():
        for each in table.rows:
            for data in datasets():
                shares = [each.values.get((data, f"delta{n}")) for n in (1, 2, 3)]
                known = [share for share in shares if share is not None]
                assert known == sorted(known)
                assert all(0 < share < 1 for share in known)


def test_a_method_printed_twice_has_the_same_numbers() -> None:
    seen = defaultdict(set)
    for table in tables().values():
        for each in table.rows:
            method = each.name.replace("NeWCRFs", "NeWCRF").removesuffix(" (B-L)")
            for (data, metric), value in each.values.items():
                seen[method, data, metric].add(value)
    different = {cell: {str(value) for value in values} for cell, values in seen.items() if len(values) > 1}
    # Rounded to 10 cm by Table 4.
    assert different == {("LocalBins", "diode-outdoor", "rmse"): {"10.27", "10.273"}}


@pytest.mark.parametrize("dataset", ZERO_SHOT)
def test_rows_of_an_unseen_data_set_have_all_six_metrics(dataset: str) -> None:
    rows = method_rows(dataset)
    full = [
        method for method, scores in rows if scores.keys() == {"rel", "rmse", "log10", "delta1", "delta2", "delta3"}
    ]
    assert full == [each.name for each in tables()[f"{dataset}-full"].rows]
    # The rest are the models of Table 2, REL only.
    assert len(rows) - len(full) == (9 if dataset in ("ibims", "vkitti2") else 0)


def test_rows_of_nyu_are_each_there_once() -> None:
    rows = dict(method_rows("nyu"))
    assert len(rows) == len(method_rows("nyu"))
    # Table 1; 5 other backbones; 7 heads; 3 routers; Table 2 without PixelBins-X-NK, and ZoeD-M12-NK is in Table 1.
    assert len(rows) == 17 + 5 + 7 + 3 + 9
    assert next(iter(rows)) == "Eigen et al."
    assert {name: float(value) for name, value in rows["ZoeD-M12-NK"].items()} == {
        "delta1": 0.953, "delta2": 0.995, "delta3": 0.999, "rel": 0.077, "rmse": 0.277, "log10": 0.033,
    }  # fmt: skip
    assert "log10" not in rows["Eigen et al."]
    assert "PixelBins-X-NK†" not in rows


def test_a_data_set_that_is_not_in_the_paper_has_no_rows() -> None:
    assert method_rows("my photos") == []


def test_numbers_of_one_metric() -> None:
    assert numbers("kitti", "rmse") == [
        ("Labeled Router", Decimal("2.452")),
        ("Trained Router", Decimal("2.362")),
        ("Auto Router", Decimal("2.584")),
    ]
    assert dict(numbers("kitti", "rel"))["ZoeD-M12-NK"] == Decimal("0.057")
    assert numbers("kitti", "log10") == []


@pytest.mark.parametrize(("dataset", "metric"), [("kiti", "rel"), ("kitti", "REL"), ("kitti", "mri_metrics")])
def test_unknown_name_is_an_error_that_lists_the_known(dataset: str, metric: str) -> None:
    with pytest.raises(InputError, match=r"the paper has no '.*'; it has .*(kitti|rmse)"):
        numbers(dataset, metric)


def test_data_sets_add_up_to_the_caption() -> None:
    unseen = [data for data in datasets().values() if not data.seen_in_training]
    assert sum(data.eval_samples for data in unseen if data.domain == "Indoor") == 13165
    assert sum(data.eval_samples for data in unseen if data.domain == "Outdoor") == 6597
    assert [data.id for data in datasets().values() if data.seen_in_training] == ["nyu", "kitti"]
    assert (datasets()["nyu"].train_samples, datasets()["nyu"].eval_samples) == ("24k", 654)
    assert [data.id for data in datasets().values() if data.type == "Synthetic"] == ["hypersim", "vkitti2"]


def test_protocols_are_those_of_the_data_set_table() -> None:
    for name, data in datasets().items():
        protocol = PROTOCOLS[name]
        assert (protocol.min_depth, protocol.max_depth) == (data.min_depth, data.max_depth)
        assert protocol.crop.startswith(data.crop.lower())
        assert protocol.kitti_crop == (data.note == "‡")


def test_every_model_has_its_preset() -> None:
    assert len({(model.name, model.note) for model in models()}) == 12
    for model in models():
        preset = PRESETS[model.name.lower() + ("-one-head" if model.note else "")]
        assert len(preset.domains) == model.heads
    nk = next(model for model in models() if model.name == "ZoeD-M12-NK" and not model.note)
    assert (nk.relative_training, nk.metric_training, nk.heads) == ("M12", "NYU+KITTI", 2)
    assert models()[0].relative_training is None


def test_sizes_typed_from_the_paper() -> None:
    sizes = {each.method: (each.encoder, each.parameters) for each in parameters()}
    assert sizes["ZoeDepth (B-L)"] == ("Beit-L", "345M")
    assert sizes["NeWCRFs"] == ("Swin-L", "270M")
    assert sizes["SharpNet"] == (None, None)
