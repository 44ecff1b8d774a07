"""The paper's comparisons of heads and routers, a recipe for each row of its Tables 2, 5 and 6.

``zoedepth train table_2_newcrfs --data nyu=... kitti=... --out runs/newcrfs --init runs/m12/step_270000``, and likewise
for the others; Table 5 takes NYU alone. ``--init`` is the relative pre-training M12 (``imagenet`` for a row X).
docs/paper.md says which recipe is which row, and gives the paper's number. Not run: there was no GPU and no such data.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from zoedepth.config import (
    AttractorConfig,
    Domain,
    DornConfig,
    HeadConfig,
    NaiveConfig,
    NewCrfsConfig,
    PixelBinsConfig,
    RouterConfig,
    SplitterConfig,
)
from zoedepth.presets import TRAINED
from zoedepth.recipes import metric
from zoedepth.train.config import SourceConfig, TrainConfig


def table_2(head: HeadConfig) -> TrainConfig:
    """Return the recipe of one head for NYU and KITTI together, to 80 m: a row "modified to use our DPT-BEiT-L"."""
    recipe = metric.nyu_and_kitti("zoed-m12-nk-one-head")
    return replace(recipe, model=replace(TRAINED["zoed-m12-nk-one-head"], head=head))


def table_5(head: HeadConfig) -> TrainConfig:
    """Return the recipe of ZoeD-M12-N on NYU with another head."""
    recipe = metric.nyu("zoed-m12-n")
    return replace(recipe, model=replace(TRAINED["zoed-m12-n"], head=head))


def table_6(router: RouterConfig) -> TrainConfig:
    """Return the recipe of a router between two heads, on NYU and KITTI."""
    recipe = metric.nyu_and_kitti("zoed-m12-nk")
    auto = router.kind == "auto"
    return replace(
        recipe,
        model=replace(TRAINED["zoed-m12-nk"], router=router),
        # R.3, the auto router, sees no label: it learns from the depth, and the heads learn from their mixture.
        domain_weight=0.0 if auto else recipe.domain_weight,
        route_by_label=not auto,
    )


def three_heads() -> TrainConfig:
    """Return a recipe with one head more than the paper: NYU, KITTI, and your own photos without a domain, to 300 m."""
    recipe = metric.nyu_and_kitti("zoed-m12-nk")
    model = TRAINED["zoed-m12-nk"]
    return replace(
        recipe,
        model=replace(model, domains=(*model.domains, Domain("other", 1e-3, 300.0))),
        sources=(*recipe.sources, SourceConfig("other", domain="other")),
    )


ABLATIONS: dict[str, Callable[[], TrainConfig]] = {
    "table_2_dorn": partial(table_2, DornConfig()),
    "table_2_localbins": partial(table_2, SplitterConfig()),
    "table_2_pixelbins": partial(table_2, PixelBinsConfig()),
    "table_2_newcrfs": partial(table_2, NewCrfsConfig()),
    "table_5_naive": partial(table_5, NaiveConfig()),
    "table_5_splitter": partial(table_5, SplitterConfig(probability="log-binomial")),
    "table_5_exponential": partial(table_5, AttractorConfig(kind="exponential")),
    "table_5_inverse_8_8_8_8": partial(table_5, AttractorConfig(n_attractors=(8, 8, 8, 8))),
    "table_5_inverse_16_2_2_16": partial(table_5, AttractorConfig(n_attractors=(16, 2, 2, 16))),
    "table_5_inverse_1_4_8_16": partial(table_5, AttractorConfig(n_attractors=(1, 4, 8, 16))),
    "table_5_inverse_16_8_4_1": partial(table_5, AttractorConfig()),
    "table_5_softmax": partial(table_5, AttractorConfig(probability="softmax")),
    "table_5_sum": partial(table_5, AttractorConfig(reduce="sum")),
    "table_6_labeled": partial(table_6, RouterConfig("labeled")),
    "table_6_trained": partial(table_6, RouterConfig("trained")),
    "table_6_auto": partial(table_6, RouterConfig("auto")),
    "three_heads": three_heads,
}
"""Name on the command line → function. (The softmax stands in the paper's text beside Table 5; the sum is Eqs. 2 and 3
as they are printed, where the released code takes the mean.)"""
