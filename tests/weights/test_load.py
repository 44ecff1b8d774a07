import json
import resource
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from zoedepth.config import to_dict
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import ENCODERS, PRESETS
from zoedepth.weights.load import available_models, load_model, save_model


def pixels() -> torch.Tensor:
    return torch.rand(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))


@pytest.fixture
def file(tiny_model: ZoeDepth, tmp_path: Path) -> Path:
    save_model(tiny_model, tmp_path / "model.safetensors")
    return tmp_path / "model.safetensors"


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


# --- there and back ---------------------------------------------------------------------------------------------------


def test_round_trip_is_bit_equal(tiny_model: ZoeDepth, file: Path):
    loaded = load_model(file)
    assert loaded.config == tiny_model.config
    assert not loaded.training
    saved, found = tiny_model.state_dict(), loaded.state_dict()
    assert saved.keys() == found.keys()
    assert all(torch.equal(saved[name], found[name]) and saved[name].dtype == found[name].dtype for name in saved)
    with torch.no_grad():
        assert torch.equal(loaded(pixels()).depth, tiny_model(pixels()).depth)


def test_half_precision_file_is_half_the_size_and_loads_as_float32(tiny_model: ZoeDepth, file: Path, tmp_path: Path):
    half = tmp_path / "half.safetensors"
    save_model(tiny_model, half, dtype=torch.float16)
    assert half.stat().st_size < 0.6 * file.stat().st_size
    found = load_model(half).state_dict()
    for name, value in tiny_model.state_dict().items():
        assert found[name].dtype == value.dtype
        assert torch.equal(found[name], value.half().float())


def test_integers_of_a_network_survive_half_precision(tiny_model: ZoeDepth, tmp_path: Path):
    """Batch norm counts its batches in an integer, which float16 could not hold."""
    model = ZoeDepth(replace(tiny_model.config, encoder=ENCODERS["tf_efficientnet_lite0"]))
    counters = [value for value in model.state_dict().values() if value.dtype == torch.int64]
    for counter in counters:
        counter.fill_(1_000_001)
    save_model(model, tmp_path / "model.safetensors", dtype=torch.float16)
    loaded = load_model(tmp_path / "model.safetensors")
    found = [value for value in loaded.state_dict().values() if value.dtype == torch.int64]
    assert len(found) == len(counters) > 0
    assert all(value.item() == 1_000_001 for value in found)


def test_folder_with_a_model_is_loaded(tiny_model: ZoeDepth, file: Path):
    assert load_model(file.parent).config == tiny_model.config
    assert load_model(str(file)).config == tiny_model.config


def test_saving_leaves_the_model_as_it_is(tiny_model: ZoeDepth, tmp_path: Path):
    tiny_model.train()
    before = {name: value.clone() for name, value in tiny_model.state_dict().items()}
    save_model(tiny_model, tmp_path / "model.safetensors", dtype=torch.float16)
    assert tiny_model.training
    assert all(torch.equal(before[name], value) for name, value in tiny_model.state_dict().items())


def test_config_in_the_file_is_plain_json(tiny_model: ZoeDepth, file: Path):
    with safe_open(str(file), framework="pt") as opened:
        config = json.loads(opened.metadata()["config"])
    assert config == json.loads(json.dumps(to_dict(tiny_model.config)))


# --- names ------------------------------------------------------------------------------------------------------------


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match="no model named 'zoed-m13-n'") as caught:
        load_model("zoed-m13-n")
    assert available_models()
    assert all(name in str(caught.value) for name in available_models())


def test_model_of_the_paper_without_weights_says_so():
    with pytest.raises(InputError, match="zoed-x-n is a model of the paper whose weights nobody published"):
        load_model("zoed-x-n")


def test_available_models_are_presets():
    assert set(available_models()) <= set(PRESETS)


@pytest.mark.parametrize("name", ["model.safetensors", "folder/zoed-lite"])
def test_missing_file_is_named(tmp_path: Path, name: str):
    with pytest.raises(InputError, match=f"no file .*{name}"):
        load_model(tmp_path / name)


def test_folder_without_a_model_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=tmp_path.name):
        load_model(tmp_path)


# --- damaged files ----------------------------------------------------------------------------------------------------


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
    "torch": (lambda path: torch.save({"weight": torch.zeros(3)}, path), "weights of no ZoeDepth"),
    "no-metadata": (lambda path: rewrite(path, metadata=lambda texts: texts.pop("config") and texts.update(a="b")),
                    "no ZoeDepth config"),
    "other-weights": (lambda path: save_file({"weight": torch.zeros(3)}, path), "weights of no ZoeDepth"),
    "no-config": (lambda path: rewrite(path, metadata=lambda texts: texts.pop("config") and texts.update(a="b")),
                  "no ZoeDepth config"),
    "config-not-json": (lambda path: rewrite(path, metadata=lambda texts: texts.update(config="{size: 3")),
                        "makes no model"),
    "config-no-object": (lambda path: rewrite(path, metadata=lambda texts: texts.update(config="[1, 2]")),
                         "ModelConfig"),
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
    with pytest.raises(InputError):
        load_model(tmp_path / "model.safetensors")
    assert not (tmp_path / "sprung").exists()


# --- failed saves -----------------------------------------------------------------------------------------------------


def test_save_that_fails_half_way_leaves_nothing_new_and_nothing_broken(tiny_model: ZoeDepth, file: Path):
    """The disk takes no more than a part of the file; the file that was there stays as it was."""
    before = file.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))
    try:
        with pytest.raises(Exception, match=r"(?i)too large|i/o"):
            save_model(tiny_model, file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_save_over_a_folder_leaves_nothing(tiny_model: ZoeDepth, tmp_path: Path):
    (tmp_path / "folder").mkdir()
    with pytest.raises((OSError, InputError)):
        save_model(tiny_model, tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
    assert list((tmp_path / "folder").iterdir()) == []


def test_save_takes_the_place_of_an_older_file(tiny_model: ZoeDepth, file: Path):
    with torch.no_grad():
        next(tiny_model.parameters()).add_(1)
    save_model(tiny_model, file)
    assert torch.equal(next(load_model(file).parameters()), next(tiny_model.parameters()))
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_weights_too_large_for_half_precision_are_refused(tiny_model: ZoeDepth, tmp_path: Path):
    """They would become infinite, and the file could not be loaded."""
    with torch.no_grad():
        next(tiny_model.parameters()).view(-1)[0] = 1e6
    with pytest.raises(InputError, match="float16"):
        save_model(tiny_model, tmp_path / "model.safetensors", dtype=torch.float16)
    assert list(tmp_path.iterdir()) == []
