"""Licence, training data and measured numbers of weights: they go along with the weights."""

import json
from pathlib import Path

import pytest
import torch
from tests.twins import twin, twin_config

from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.provenance import Provenance, from_card, from_texts, require_licence
from zoedepth.weights.checkpoint import read_checkpoint, write_checkpoint
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import RELEASES
from zoedepth.weights.save import checkpoint_of, push_to_hub, save_model

ABOUT = Provenance("non-commercial research", "NYU Depth v2, for research", {"nyu": {"rel": 0.179, "delta1": 0.742}})


def test_texts_there_and_back():
    assert from_texts(ABOUT.to_texts()) == ABOUT
    assert from_texts({"config": "{}", **ABOUT.to_texts()}) == ABOUT
    assert Provenance().to_texts() == {}
    assert from_texts({}) == Provenance()


def test_numbers_that_json_has_not_are_left_out():
    about = Provenance(measured={"nyu": {"rel": float("nan"), "rmse": 1.0}})
    assert from_texts(about.to_texts()).measured == {"nyu": {"rmse": 1.0}}


@pytest.mark.parametrize("measured", ["[]", "{", '{"nyu": 1}', '{"nyu": {"rel": "x"}}', '{"nyu": {"rel": true}}'])
def test_damaged_numbers_are_named(measured: str):
    with pytest.raises(InputError, match="measured numbers in its metadata"):
        from_texts({"measured": measured})


def test_texts_of_anyone_are_bounded_and_one_line():
    about = from_texts({"licence": "mit\nlicense: other", "trained_on": "x" * 100_000})
    assert about.licence == "mit license: other"
    assert about.trained_on is not None
    assert len(about.trained_on) == 10_000


@pytest.mark.parametrize("licence", [None, "", "unknown", " Unknown "])
def test_no_licence_keeps_the_one_there_is(licence: str | None):
    assert ABOUT.with_licence(licence) == ABOUT
    with pytest.raises(InputError, match=r"licence of these weights is not known.*--licence"):
        require_licence(Provenance().with_licence(licence))


def test_non_commercial_weights_stay_non_commercial():
    for other in ("mit", "cc-by-4.0", "Apache-2.0"):
        with pytest.raises(InputError, match="stay non-commercial"):
            ABOUT.with_licence(other)
    assert ABOUT.with_licence("cc-by-nc-sa-3.0").licence == "cc-by-nc-sa-3.0"
    for own in ("CC-BY-NC-4.0", "for noncommercial use", "non commercial, research", "academic use"):
        with pytest.raises(InputError, match="stay non-commercial"):
            Provenance(own).with_licence("mit")
    assert Provenance("mit").with_licence("cc-by-nc-4.0").licence == "cc-by-nc-4.0"
    assert Provenance("apache-2.0").with_licence("mit").licence == "mit"


def test_training_adds_data_and_drops_numbers():
    assert ABOUT.after_training({"rooms (4 pairs)": None}) == Provenance(
        "non-commercial research", "rooms (4 pairs); before that: NYU Depth v2, for research"
    )
    assert Provenance().after_training({"rooms": None, "halls": "cc-by-4.0"}).trained_on == "rooms, halls: cc-by-4.0"


def test_terms_of_the_data_bind_the_weights():
    kitti = {"kitti (9 pairs)": "CC BY-NC-SA 3.0", "rooms (2 pairs)": "mit", "nyu (3 pairs)": "custom, research"}
    for before in (None, "MIT"):
        after = Provenance(before).after_training(kitti)
        assert after.licence == "non-commercial, as the training data: CC BY-NC-SA 3.0, custom, research"
        with pytest.raises(InputError, match="stay non-commercial"):
            after.with_licence("mit")
    assert ABOUT.after_training(kitti).licence == ABOUT.licence
    assert Provenance("MIT").after_training({"rooms": "CC BY 4.0", "halls": None}).licence == "MIT"
    assert Provenance().after_training({"rooms": "CC BY 4.0"}).licence is None


@pytest.mark.parametrize(
    ("card", "licence"),
    [
        ("---\nlicense: mit\n---\n# Model", "mit"),
        ("---\ntags: [a]\nlicense: other\nlicense_name: 'non-commercial'\n---\n", "non-commercial"),
        ("---\nlicense: unknown\n---\n", None),
        ("# Model\n\nlicense: mit", None),
        ("", None),
    ],
)
def test_licence_in_a_model_card(card: str, licence: str | None):
    assert from_card(card).licence == licence


@pytest.mark.parametrize(
    ("layout", "name"),
    [("zoedepth", "m.safetensors"), ("zoedepth", "ours"), ("huggingface", "theirs"), ("original", "m.pt")],
)
def test_every_layout_carries_it(layout, name: str, tmp_path: Path):
    twin(twin_config()).save_pretrained(tmp_path / "twin")
    checkpoint = read_checkpoint(tmp_path / "twin")
    path = write_checkpoint(checkpoint._replace(provenance=ABOUT), tmp_path / name, to=layout)
    assert read_checkpoint(path).provenance == ABOUT
    if path.is_dir():
        card = (path / "README.md").read_text()
        assert "license_name: non-commercial-research\n" in card
        assert "Training data: NYU Depth v2, for research." in card
        assert "| nyu | 0.179 | 0.742 |" in card


def test_licence_of_a_folder_is_in_its_card_where_the_weights_say_none(tmp_path: Path):
    twin(twin_config()).save_pretrained(tmp_path / "twin")
    assert read_checkpoint(tmp_path / "twin").provenance == Provenance()
    (tmp_path / "twin" / "README.md").write_bytes(b"---\nlicense: cc-by-nc-4.0\n---\n\xff")
    assert load_model(tmp_path / "twin").provenance == Provenance("cc-by-nc-4.0")


def test_loading_and_saving_hands_it_on(tmp_path: Path, tiny_model: ZoeDepth):
    tiny_model.provenance = ABOUT
    save_model(tiny_model, tmp_path / "model.safetensors")
    assert load_model(tmp_path / "model.safetensors").provenance == ABOUT
    assert checkpoint_of(tiny_model).provenance == ABOUT


def test_the_shipped_model_knows_its_terms_wherever_it_goes(tmp_path: Path):
    about = load_model("zoed-lite").provenance
    assert about == RELEASES["zoed-lite"].provenance == load_model(RELEASES["zoed-lite"].path).provenance
    assert about.licence == "non-commercial research"
    assert "CC BY-NC-SA" in (about.trained_on or "")
    assert about.measured["NYU Depth v2, 654 test pairs"]["rel"] == 0.162
    save_model(load_model("zoed-lite"), tmp_path / "copy.safetensors", dtype=torch.float16)
    assert json.dumps(load_model(tmp_path / "copy.safetensors").provenance.measured) == json.dumps(about.measured)


def test_weights_without_a_licence_are_not_uploaded(tiny_model: ZoeDepth):
    with pytest.raises(InputError, match="licence of these weights is not known"):
        push_to_hub(tiny_model, "me/model")
    tiny_model.provenance = ABOUT
    with pytest.raises(InputError, match="stay non-commercial"):
        push_to_hub(tiny_model, "me/model", licence="mit")
