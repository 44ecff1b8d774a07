"""Comparisons of the paper: the rows of its tables, each with its recipe and its pre-training."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from zoedepth.errors import InputError, no_such
from zoedepth.evaluation import paper_numbers
from zoedepth.recipes import RECIPES
from zoedepth.train.config import TrainConfig

BaseName = Literal["X", "N", "K", "NK", "M12"]
"""The relative pre-training that a row starts from. X: none, ImageNet weights."""

Column = tuple[str, str]
"""(Data set, field of ``zoedepth.metrics.Metrics``)."""


@dataclass(frozen=True)
class Row:
    """A row: what is trained, and which numbers of the paper stand beside it."""

    name: str
    """Name as the paper prints it, with its mark."""
    recipe: str
    """Name in ``RECIPES``."""
    base: BaseName = "M12"
    encoder: str | None = None
    """Another encoder than the recipe's, by its timm name."""
    printed: Mapping[Column, str] = field(default_factory=dict)
    """Numbers that the paper has in its text. Those of its table are found by the name."""

    def config(self) -> TrainConfig:
        """Return the full-size configuration of its training."""
        return RECIPES[self.recipe]()


@dataclass(frozen=True)
class Table:
    """A comparison of the paper: rows, columns, and what mean relative improvements are relative to."""

    id: str
    title: str
    rows: tuple[Row, ...]
    columns: tuple[Column, ...]
    reference: str
    """Name of the row that mRI is relative to."""
    variable: str
    """The one thing that the rows differ in, in words."""
    paper: tuple[str, ...] = ()
    """Ids of the paper's tables that have the rows, see ``zoedepth.evaluation.paper_numbers.tables``."""
    small_rows: tuple[Row, ...] | None = None
    """The rows of the small comparison, where they are others; None: the same."""

    def printed(self, row: Row, column: Column) -> str:
        """Return the paper's number; empty where it has none."""
        if column in row.printed:
            return row.printed[column]
        found = self._paper_row(row)
        value = None if found is None else found.values.get(column)
        return "" if value is None else str(value)

    def printed_mri(self, row: Row, dataset: str) -> str:
        """Return the paper's mean relative improvement, percent; empty where it has none."""
        found = self._paper_row(row)
        value = None if found is None else found.mri.get(dataset)
        return "" if value is None else str(value)

    def _paper_row(self, row: Row) -> paper_numbers.PaperRow | None:
        rows = (each for name in self.paper for each in paper_numbers.tables()[name].rows)
        return next((each for each in rows if each.name == row.name), None)


_N: tuple[Column, ...] = (("nyu", "rel"), ("nyu", "rmse"))
_NK: tuple[Column, ...] = (("nyu", "rel"), ("kitti", "rel"), ("nyu", "rmse"), ("kitti", "rmse"))

_ATTRACTORS = "Metric bins, Inverse Attractor, "


def _grid() -> tuple[Row, ...]:
    bases: tuple[BaseName, ...] = ("X", "N", "NK", "M12")
    rows = []
    for base in bases:
        # The recipes are named after the models of the paper; those of other cells are of the same architecture.
        start = "x" if base == "X" else "m12"
        rows += [
            Row(f"ZoeD-{base}-N", f"zoed_{start}_n", base),
            Row(f"ZoeD-{base}-K", f"zoed_{start}_k", base),
            Row(f"ZoeD-{base}-NK†", f"zoed_{start}_nk_one_head", base),
            Row(f"ZoeD-{base}-NK", f"zoed_{start}_nk", base),
        ]
    return tuple(rows)


def _backbone(mark: str, recipe: str) -> Row:
    return Row(f"ZoeD-M12-N ({mark})", recipe)


def _lite(number: int) -> Row:
    return Row(f"ZoeD-M12-N (Lite{number})", "zoed_m12_n", encoder=f"tf_efficientnet_lite{number}")


TABLES: dict[str, Table] = {
    table.id: table
    for table in (
        Table(
            "table-2",
            "Trained on NYU and KITTI (paper Table 2)",
            (
                Row("DORN-X-NK†", "dorn_nk", "X"),
                Row("LocalBins-X-NK†", "localbins_nk", "X"),
                Row("PixelBins-X-NK†", "pixelbins_nk", "X"),
                Row("NeWCRFs-X-NK†", "newcrfs_nk", "X"),
                Row("DORN-M12-NK†", "table_2_dorn"),
                Row("LocalBins-M12-NK†", "table_2_localbins"),
                Row("PixelBins-M12-NK†", "table_2_pixelbins"),
                Row("NeWCRFs-M12-NK†", "table_2_newcrfs"),
                Row("ZoeD-X-NK†", "zoed_x_nk_one_head", "X"),
                Row("ZoeD-M12-NK†", "zoed_m12_nk_one_head"),
                Row("ZoeD-M12-NK", "zoed_m12_nk"),
            ),
            (("nyu", "rel"), ("kitti", "rel"), ("ibims", "rel"), ("vkitti2", "rel")),
            reference="NeWCRFs-X-NK†",
            variable="the system; of the rows M12†, the head alone",
            paper=("table-2",),
        ),
        Table(
            "table-5",
            "Metric head variants (paper Table 5)",
            (
                Row("Naive head", "table_5_naive"),
                Row("Metric bins, Splitter, factor = 2", "table_5_splitter"),
                Row("Metric bins, Exponential Attractor, {16,8,4,1}", "table_5_exponential"),
                Row(_ATTRACTORS + "{8,8,8,8}", "table_5_inverse_8_8_8_8"),
                Row(_ATTRACTORS + "{16,2,2,16}", "table_5_inverse_16_2_2_16"),
                Row(_ATTRACTORS + "{1,4,8,16}", "table_5_inverse_1_4_8_16"),
                Row(_ATTRACTORS + "{16,8,4,1}", "table_5_inverse_16_8_4_1"),
                Row("the same with softmax (text)", "table_5_softmax", printed={("nyu", "rel"): "0.077"}),
            ),
            _N,
            reference="Naive head",
            variable="the head",
            paper=("table-5",),
        ),
        Table(
            "table-6",
            "Router variants (paper Table 6)",
            (
                Row("Labeled Router", "table_6_labeled"),
                Row("Trained Router", "table_6_trained"),
                Row("Auto Router", "table_6_auto"),
            ),
            _NK,
            reference="Labeled Router",
            variable="the router, and what it learns from",
            paper=("table-6",),
        ),
        Table(
            "log-binomial",
            "Probabilities of the bins (paper section 4, text)",
            (
                Row("Softmax", "table_5_softmax", printed={("nyu", "rel"): "0.077"}),
                Row("Log-binomial", "table_5_inverse_16_8_4_1", printed={("nyu", "rel"): "0.075"}),
            ),
            _N,
            reference="Softmax",
            variable="the probabilities",
        ),
        Table(
            "sum-or-mean",
            "Pull of the attractors: Eqs. 2 and 3 as printed, and as released (not in the paper)",
            (Row("Sum", "table_5_sum"), Row("Mean", "table_5_inverse_16_8_4_1")),
            _N,
            reference="Sum",
            variable="the sum or the mean of the pulls",
        ),
        Table(
            "grid",
            "Relative pre-training and metric fine-tuning (paper section 4 and appendix)",
            _grid(),
            (("nyu", "rel"), ("kitti", "rel")),
            reference="ZoeD-X-NK†",
            variable="pre-training and fine-tuning",
            paper=("table-1", "table-2"),
        ),
        Table(
            "backbones",
            "Backbones (paper appendix)",
            (
                _backbone("S-L", "zoed_m12_n_swin_l"),
                _backbone("S2-T", "zoed_m12_n_swin2_t"),
                _backbone("S2-B", "zoed_m12_n_swin2_b"),
                _backbone("S2-L", "zoed_m12_n_swin2_l"),
                _backbone("B-B", "zoed_m12_n_beit_b"),
                _backbone("B-L", "zoed_m12_n"),
            ),
            tuple(("nyu", metric) for metric in ("delta1", "delta2", "delta3", "rel", "rmse", "log10")),
            reference="ZoeD-M12-N (S2-T)",
            variable="the encoder",
            paper=("nyu-backbones",),
            small_rows=(_lite(0), _lite(1), _lite(2)),
        ),
        Table(
            "convergence",
            "AdaBins and PixelBins on NYU and KITTI (paper section 4: they do not converge)",
            (
                Row("AdaBins-X-NK†", "adabins_nk", "X"),
                Row("PixelBins-X-NK†", "pixelbins_nk", "X"),
                Row("NeWCRFs-X-NK†", "newcrfs_nk", "X"),
            ),
            (("nyu", "rel"), ("kitti", "rel")),
            reference="NeWCRFs-X-NK†",
            variable="the system",
            paper=("table-2",),
        ),
    )
}
"""Name on the command line → comparison."""


def find_table(name: str) -> Table:
    """Return a comparison by name.

    Raises:
        InputError: there is none of this name.
    """
    if name not in TABLES:
        raise no_such("table", name, TABLES)
    return TABLES[name]


def rows_of(table: Table, *, small: bool) -> tuple[Row, ...]:
    """Return the rows of a comparison at full size, or of its small form."""
    return table.small_rows if small and table.small_rows is not None else table.rows


def require_known_bases(names: Mapping[str, str]) -> None:
    """Check the names of pre-trainings.

    Raises:
        InputError: one is not N, K, NK or M12.
    """
    if unknown := sorted(set(names) - {"N", "K", "NK", "M12"}):
        raise InputError(f"--base names {unknown}: give NAME=WEIGHTS, with N, K, NK or M12 for NAME")
