import ast
import re
from dataclasses import replace

import pytest
from huggingface_hub import ModelCard
from hypothesis import given, settings
from hypothesis import strategies as st

from zoedepth.config import INDOOR, Domain, ModelConfig, RouterConfig
from zoedepth.presets import PRESETS
from zoedepth.weights.card import model_card

NK = PRESETS["zoed-m12-nk"]
METRICS = {
    "rel": 0.075, "rmse": 0.27, "log10": 0.032, "delta1": 0.955, "delta2": 0.995, "delta3": 0.999, "silog": 8.0,
    "sq_rel": 0.02, "rmse_log": 0.1,
}  # fmt: skip


def card(
    *, config: ModelConfig = NK, name: str = "lab/model", layout: str = "zoedepth", **more: object
) -> tuple[dict, str]:
    """The front matter as the Hub reads it, and the text below it."""
    text = model_card(config, name=name, layout=layout, **more)
    parsed = ModelCard(text)
    return parsed.data.to_dict(), parsed.text


def examples(text: str) -> list[str]:
    """The Python code in Markdown; each must be code."""
    found = re.findall(r"^```python\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    for code in found:
        ast.parse(code)
    return found


def test_card_says_that_photos_are_squeezed():
    _, text = card(config=replace(NK, resize="squeeze"))
    assert "384 x 512 pixels (height x width): photos are squeezed to it" in text


def test_card_without_anything_known_says_so():
    front, text = card()
    assert front == {
        "pipeline_tag": "depth-estimation",
        "library_name": "zoedepth",
        "license": "unknown",
        "tags": ["depth-estimation", "metric-depth", "zoedepth"],
    }
    assert "Weights (this model): not stated." in text
    assert "Training data: not stated." in text
    assert "Not run." in text


def test_card_describes_the_model():
    _, text = card()
    assert "`beit_large_patch16_384`" in text
    assert "384 x 512 pixels (height x width): photos are resized near it" in text
    assert "| indoor | 0.001 m | 10 m |" in text
    assert "| outdoor | 0.001 m | 80 m |" in text
    assert "chooses for every photo" in text
    assert "2302.12288" in text


def test_card_says_which_lenses_the_metres_are_for():
    _, text = card()
    assert "Camera: metres hold for lenses like those of the training photos, whose focal lengths were" in text
    assert "415.58 for indoor, 787.13 for outdoor." in text
    _, text = card(config=replace(NK, domains=(INDOOR,)))
    assert "lenses like those of the training photos.\n" in text
    _, text = card(config=replace(NK, canonical_camera=True))
    assert "Camera: metres fit any lens whose focal length is known" in text


def test_single_head_and_single_size_are_said():
    swin = next(config for config in PRESETS.values() if config.encoder.family == "swin")
    _, text = card(config=replace(swin, domains=(INDOOR,)))
    assert "the only one it takes" in text
    assert "Heads: 1, for every photo." in text


@pytest.mark.parametrize(
    ("licence", "fields"),
    [
        ("mit", {"license": "mit"}),
        ("CC-BY-NC-4.0", {"license": "cc-by-nc-4.0"}),
        ("Non-commercial research only: see NYU.", {"license": "other",
                                                    "license_name": "non-commercial-research-only-see-nyu"}),
    ],
)  # fmt: skip
def test_licence_is_one_the_hub_takes(licence: str, fields: dict[str, str]):
    front, text = card(licence=licence, trained_on="NYU Depth v2, for research.")
    assert {key: value for key, value in front.items() if key.startswith("license")} == fields
    assert f"Weights (this model): {licence.rstrip('.')}.\n" in text
    assert "Training data: NYU Depth v2, for research. Weights carry" in text
    assert "Code (the package `zoedepth`): MIT." in text


def test_metrics_are_in_the_table_and_for_the_hub():
    parsed = ModelCard(model_card(NK, name="lab/model", layout="zoedepth", metrics={"NYU | test": METRICS}))
    assert parsed.data["model_name"] == "lab/model"
    results = parsed.data["eval_results"]
    assert {result.metric_type: result.metric_value for result in results} == METRICS
    assert {(result.dataset_name, result.dataset_type, result.task_type) for result in results} == {
        ("NYU | test", "nyu-test", "depth-estimation")
    }
    assert "| NYU \\| test | 0.075 | 0.270 | 0.032 | 0.955 | 0.995 | 0.999 |" in parsed.text
    assert "Not run" not in parsed.text


def test_metrics_that_were_not_measured_are_not_run_and_unknown_ones_are_left_out():
    metrics = {"nyu": {"rel": 0.1, "delta1": 0.9}, "kitti": {"rel": 0.2, "a | b": 1.0}}
    parsed = ModelCard(model_card(NK, name="lab/model", layout="zoedepth", metrics=metrics))
    assert (
        "| data | REL | delta1 |\n| --- | --- | --- |\n| nyu | 0.100 | 0.900 |\n| kitti | 0.200 | not run |"
        in parsed.text
    )
    assert {(result.dataset_name, result.metric_type) for result in parsed.data["eval_results"]} == {
        ("nyu", "rel"), ("nyu", "delta1"), ("kitti", "rel")
    }  # fmt: skip


def test_data_sets_whose_names_look_alike_to_the_hub_stay_apart():
    metrics = {"a b": METRICS, "A-B": METRICS | {"rel": 0.5}, "房间": METRICS, "街道": METRICS}
    results = ModelCard(model_card(NK, name="lab/model", layout="zoedepth", metrics=metrics)).data["eval_results"]
    rel = {result.dataset_name: result.metric_value for result in results if result.metric_type == "rel"}
    assert rel == {"a b": 0.075, "A-B": 0.5, "房间": 0.075, "街道": 0.075}
    assert len(results) == 4 * len(METRICS)


def test_own_layout_is_loaded_with_zoedepth():
    _, text = card()
    (code,) = examples(text)
    assert 'load_model("lab/model")' in code
    assert "transformers" not in text


def test_huggingface_layout_is_loaded_with_both_and_warns_of_the_vote():
    front, text = card(layout="huggingface")
    assert front["library_name"] == "transformers"
    ours, theirs = examples(text)
    assert 'load_model("lab/model")' in ours
    assert 'pipeline("depth-estimation", model="lab/model")' in theirs
    assert "one photo at a time" in text
    _, single = card(layout="huggingface", config=PRESETS["zoed-m12-n"])
    assert "one photo at a time" not in single


def test_labeled_router_is_told_the_domain():
    _, text = card(config=replace(NK, router=RouterConfig("labeled")))
    assert 'predictor("photo.jpg", domain="indoor")' in examples(text)[0]


@pytest.mark.parametrize(
    "name", ["yes", "1.0", "a: b # c", "---", "'\"\\", "a\n---\nlicense: mit", "{}", "```", "œ 🙂"]
)
def test_awkward_names(name: str):
    check_awkward(name)


@settings(max_examples=20, deadline=None)
@given(st.text(min_size=1))
def test_any_name(name: str):
    check_awkward(name)


def check_awkward(name: str) -> None:
    text = model_card(NK, name=name, layout="huggingface", licence=name, trained_on=name, metrics={name: METRICS})
    front, body = (parsed := ModelCard(text)).data, parsed.text
    assert front["pipeline_tag"] == "depth-estimation"
    assert front["tags"] == ["depth-estimation", "metric-depth", "zoedepth"]
    assert front["model_name"] == " ".join(name.split())
    assert front["license"] == "other" or front["license"] == name.strip().lower()
    assert [line for line in body.splitlines() if line.startswith("## ")] == [
        "## Use",
        "## Measured",
        "## Licence",
        "## Cite",
    ]
    assert len(examples(body)) == 2


def test_awkward_domain_stays_in_its_cell():
    _, text = card(config=replace(NK, domains=(Domain("a|b\nc", 0.5, 2.5), INDOOR)))
    assert "| a\\|b c | 0.5 m | 2.5 m |" in text


def test_model_without_metric_heads_promises_no_metres():
    card = model_card(PRESETS["dpt-beit-large-384"], name="midas", layout="zoedepth")
    assert "Relative depth, inverse" in card
    assert "predictor.relative(" in card
    assert "metres" not in card
    assert "| domain |" not in card
