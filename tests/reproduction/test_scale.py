"""How large a reproduction is: as in the paper, or small."""

import pytest

from zoedepth.config import BaselineConfig, ModelConfig
from zoedepth.presets import MINIATURE
from zoedepth.reproduction.scale import FULL, SMALL, Scale
from zoedepth.reproduction.tables import TABLES, rows_of


@pytest.mark.parametrize("scale", [FULL, SMALL], ids=["full", "small"])
def test_rows_that_differ_in_the_head_share_their_pre_training(scale: Scale) -> None:
    for name in ("table-5", "table-6", "log-binomial"):
        models = [scale.adapt(row).model for row in TABLES[name].rows]
        bases = {scale.pretrain("M12", model) for model in models if isinstance(model, ModelConfig)}
        assert len(bases) == 1
        (trainings,) = bases
        assert [each.stage for each in trainings] == ["relative"] * len(trainings)
        assert {each.model.encoder_name for each in trainings} == {models[0].encoder_name}


def test_pre_trainings_have_the_data_of_their_name() -> None:
    model = SMALL.adapt(TABLES["table-5"].rows[0]).model
    assert isinstance(model, ModelConfig)
    names = {
        base: [source.name for each in SMALL.pretrain(base, model) for source in each.sources]
        for base in ("X", "N", "K", "NK", "M12")
    }
    assert names == {
        "X": [], "N": ["nyu"], "K": ["kitti"], "NK": ["nyu", "kitti"], "M12": ["nyu", "kitti", "relative", "scenes"],
    }  # fmt: skip
    model = FULL.adapt(TABLES["table-5"].rows[0]).model
    assert isinstance(model, ModelConfig)
    full = FULL.pretrain("M12", model)
    assert len(full[1].sources) == 12


@pytest.mark.parametrize("name", TABLES)
def test_small_rows_keep_what_is_compared_and_have_one_encoder_and_decoder(name: str) -> None:
    for row in rows_of(TABLES[name], small=True):
        small, paper = SMALL.adapt(row), row.config()
        assert (small.route_by_label, small.domain_weight) == (paper.route_by_label, paper.domain_weight)
        assert [source.name for source in small.sources] == [source.name for source in paper.sources]
        if isinstance(small.model, BaselineConfig):
            assert isinstance(paper.model, BaselineConfig)
            assert type(small.model.network) is type(paper.model.network)
            continue
        assert isinstance(paper.model, ModelConfig)
        assert (small.model.head, small.model.router) == (paper.model.head, paper.model.router)
        assert small.model.decoder == MINIATURE.decoder
        assert small.model.encoder.name == (row.encoder or "tf_efficientnet_lite0")


@pytest.mark.parametrize("name", TABLES)
def test_small_trainings_compute_in_the_same_numbers_on_every_machine(name: str) -> None:
    for row in rows_of(TABLES[name], small=True):
        config = SMALL.adapt(row)
        before = SMALL.pretrain(row.base, config.model) if isinstance(config.model, ModelConfig) else ()
        assert {each.precision for each in (config, *before)} == {"32-true"}
