"""Files whose weights do not fit a model: each is an error that names the file and the damage."""

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from tests.weights.layouts.layouts import tiny

from zoedepth.config import INDOOR, OUTDOOR, AnyModelConfig
from zoedepth.errors import InputError, InputWarning
from zoedepth.model.linear import SWITCH
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS, in_training_cameras
from zoedepth.weights import fit
from zoedepth.weights.checkpoint import Checkpoint
from zoedepth.weights.fit import misfits, model_of
from zoedepth.weights.layouts import original
from zoedepth.weights.load import load_model


def rewrite(
    path: Path,
    *,
    weights: Callable[[dict[str, torch.Tensor]], object] = lambda weights: None,
    metadata: Callable[[dict[str, str]], object] = lambda metadata: None,
) -> None:
    """Change the weights and the metadata of a file in place."""
    with safe_open(str(path), framework="pt") as opened:
        tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118  # not a dict
        texts = dict(opened.metadata())
    weights(tensors)
    metadata(texts)
    save_file(tensors, path, metadata=texts)


def rewrite_config(path: Path, change: Callable[[dict], object]) -> None:
    """Change the config in a file."""

    def apply(metadata: dict[str, str]) -> None:
        config = json.loads(metadata["config"])
        change(config)
        metadata["config"] = json.dumps(config)

    rewrite(path, metadata=apply)


HUGE = 10**10


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ({"type": "dorn", "n_intervals": HUGE}, "n_intervals must be 2 to 10,000"),
        ({"type": "newcrfs", "n_blocks": HUGE}, "makes no model of"),
        ({"type": "adabins", "n_layers": HUGE}, "makes no model of"),
    ],
)
def test_config_that_asks_for_more_than_the_file_can_hold_builds_nothing(
    head: dict[str, Any], message: str, file: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(fit, "build_model", lambda _: pytest.fail("it was built"))
    rewrite_config(file, lambda config: config.update(head=head))
    with pytest.raises(InputError, match=message):
        load_model(file)


def test_wrong_setting_of_the_machine_is_not_blamed_on_the_weights(file: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(SWITCH, "true")
    with pytest.raises(InputError, match=f"^{SWITCH} is 'true'"):
        load_model(file)


def test_one_head_of_the_original_that_is_no_release_is_said_and_may_be_kittis():
    config, weights, *_ = tiny()
    theirs = original.write(config, weights)

    def loaded(*compat: str) -> AnyModelConfig:
        read, ours, _ = original.read(theirs)
        return model_of(Checkpoint(read, ours, "original", str), source="own.pt", compat=compat).config

    with pytest.warns(InputWarning, match=r"^own\.pt does not say which data .* 10 m.*--compat 80m"):
        near = loaded()
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        far = loaded("80m")
    assert near.domains == in_training_cameras(replace(near, domains=(INDOOR,))).domains
    assert far == in_training_cameras(replace(near, domains=(OUTDOOR,)))


def test_released_checkpoint_of_one_head_is_nyus_without_a_warning():
    released = PRESETS["zoed-m12-n"]
    assert not fit._is_taken_for_nyus(released, "ZoeD_M12_N.pt")
    assert fit._is_taken_for_nyus(released, "mine.pt")
    other = replace(released, encoder=replace(released.encoder, taps=(0, 1, 2, 3)))
    assert fit._is_taken_for_nyus(other, "ZoeD_M12_N.pt")


def test_weights_of_the_model_itself_fit(tiny_model: ZoeDepth):
    state = tiny_model.state_dict()
    assert misfits(state, state) == []
    assert misfits(state, {name: value.half() for name, value in state.items()}) == []
    name, value = next(iter(state.items()))
    assert misfits(state, {**state, name: value.long()}) == [("mistyped", name, " is torch.int64")]


def cut(path: Path, length: int) -> None:
    path.write_bytes(path.read_bytes()[:length])


def first_name(weights: dict[str, torch.Tensor]) -> str:
    return min(name for name, value in weights.items() if value.ndim > 1)


def put(value: float) -> Callable[[dict[str, torch.Tensor]], object]:
    return lambda weights: weights[first_name(weights)].view(-1)[:1].fill_(value)


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "empty": (lambda path: path.write_bytes(b""), "not a readable safetensors file"),
    "header-cut": (lambda path: cut(path, 100), "not a readable safetensors file"),
    "weights-cut": (lambda path: cut(path, path.stat().st_size - 10), "not a readable safetensors file"),
    "text": (lambda path: path.write_text("these are no weights\n" * 100), "not a readable safetensors file"),
    "torch": (lambda path: torch.save({"weight": torch.zeros(3)}, path), "not the weights of a known model"),
    "no-metadata": (lambda path: save_file(load_file(path), path), "no ZoeDepth config"),
    "other-weights": (lambda path: save_file({"weight": torch.zeros(3)}, path), "not the weights of a known model"),
    "no-config": (lambda path: rewrite(path, metadata=lambda texts: texts.pop("config") and texts.update(a="b")),
                  "no ZoeDepth config"),
    "config-not-json": (lambda path: rewrite(path, metadata=lambda texts: texts.update(config="{size: 3")),
                        "config in its metadata: not a JSON object"),
    "config-no-object": (lambda path: rewrite(path, metadata=lambda texts: texts.update(config="[1, 2]")),
                         "config in its metadata: not a JSON object"),
    "unknown-field": (lambda path: rewrite_config(path, lambda config: config["head"].update(shade=3)), "shade"),
    "missing-field": (lambda path: rewrite_config(path, lambda config: config.pop("encoder")), "encoder"),
    "wrong-type": (lambda path: rewrite_config(path, lambda config: config["head"].update(n_bins="8")), "n_bins"),
    "out-of-range": (lambda path: rewrite_config(path, lambda config: config["head"].update(n_bins=1)), "n_bins"),
    "unknown-encoder": (lambda path: rewrite_config(path, lambda config: config["encoder"].update(name="beit_giant")),
                        "beit_giant"),
    "impossible-taps": (lambda path: rewrite_config(path, lambda config: config["encoder"].update(taps=[0, 1, 2, 99])),
                        "tap"),
    "no-taps": (lambda path: rewrite_config(path, lambda config: config["encoder"].update(taps=[])), "tap"),
    "too-few-channels": (lambda path: rewrite_config(path, lambda config: config["encoder"].update(channels=[8])),
                         "channels"),
    "other-config": (lambda path: rewrite_config(path, lambda config: config["head"].update(n_bins=9)), "heads.0"),
    "missing-weight": (lambda path: rewrite(path, weights=lambda weights: weights.pop("decoder.project.2.weight")),
                       "missing decoder.project.2.weight"),
    "extra-weight": (lambda path: rewrite(path, weights=lambda weights: weights.update(surplus=torch.zeros(3))),
                     "unknown surplus"),
    "wrong-shape": (lambda path: rewrite(path, weights=lambda weights: weights.update(
        {"decoder.project.2.weight": torch.zeros(16, 16, 1, 1)})),
                    r"decoder.project.2.weight is \(16, 16, 1, 1\), not"),
    "nan": (lambda path: rewrite(path, weights=put(float("nan"))), "not finite"),
    "infinite": (lambda path: rewrite(path, weights=put(float("inf"))), "not finite"),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_file_is_an_error_that_names_the_file_and_the_damage(damage: str, file: Path):
    spoil, message = DAMAGES[damage]
    spoil(file)
    with pytest.raises(InputError, match=message) as caught:
        load_model(file)
    assert file.name in str(caught.value)


def test_many_misfits_are_counted_and_not_all_listed(file: Path):
    rewrite(file, weights=lambda weights: [weights.pop(name) for name in list(weights)[10:]])
    with pytest.raises(InputError, match=r"\(\d+ problems\)") as caught:
        load_model(file)
    assert len(str(caught.value)) < 2000


def test_loading_runs_no_code_of_the_file(tmp_path: Path):
    """A pickle that would write a file when it is read."""

    class Trap:
        def __reduce__(self) -> tuple:
            return Path.touch, (tmp_path / "sprung",)

    torch.save({"weight": Trap()}, tmp_path / "model.safetensors")
    with pytest.raises(InputError, match="refused, nothing of it was executed"):
        load_model(tmp_path / "model.safetensors")
    assert not (tmp_path / "sprung").exists()
