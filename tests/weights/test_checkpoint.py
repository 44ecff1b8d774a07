import json
import os
import resource
import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from tests.weights.layouts.layouts import TINY, same, tiny

from zoedepth.config import Domain, ModelConfig, from_dict, to_dict
from zoedepth.errors import InputError, InputWarning
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS
from zoedepth.weights.checkpoint import LAYOUTS, Checkpoint, Layout, read_checkpoint, write_checkpoint
from zoedepth.weights.fit import model_of
from zoedepth.weights.layouts import huggingface_config, original
from zoedepth.weights.load import load_model
from zoedepth.weights.save import checkpoint_of

KINDS = pytest.mark.parametrize("kind", TINY)
EVERY = pytest.mark.parametrize("layout", LAYOUTS)
TARGETS: dict[Layout, str] = {"zoedepth": "ours", "original": "original.pt", "huggingface": "theirs"}


def write(folder: Path, layout: Layout, checkpoint: Checkpoint | None = None) -> Path:
    return write_checkpoint(checkpoint or tiny(), folder / TARGETS[layout], to=layout)


def texts_of(file: Path) -> dict[str, str]:
    with safe_open(str(file), framework="pt") as opened:
        return opened.metadata()


# --- reading ----------------------------------------------------------------------------------------------------------


@KINDS
@EVERY
def test_layout_is_told_and_read(tmp_path: Path, kind: str, layout: Layout):
    checkpoint = read_checkpoint(write(tmp_path, layout, tiny(kind)))
    assert checkpoint.layout == layout
    assert same(checkpoint.weights, tiny(kind).weights)
    assert checkpoint.config == tiny(kind).config


@KINDS
def test_original_that_was_not_written_here_does_not_say_the_size_of_photos(tmp_path: Path, kind: str):
    torch.save(torch.load(write(tmp_path, "original", tiny(kind)))["model"], tmp_path / "theirs.pt")
    checkpoint = read_checkpoint(tmp_path / "theirs.pt")
    assert checkpoint.config == replace(tiny(kind).config, size=PRESETS[f"zoed-m12-{kind}"].size)


@pytest.mark.parametrize("suffix", [".pt", ".bin", ".safetensors", ""])
@pytest.mark.parametrize("container", ["torch", "safetensors"])
@EVERY
def test_layout_is_told_by_content_and_not_by_name(tmp_path: Path, layout: Layout, container: str, suffix: str):
    source = write(tmp_path, layout)
    if source.is_dir():
        shutil.copy(source / "config.json", tmp_path / "config.json")
    weights = torch.load(source)["model"] if layout == "original" else load_file(source / "model.safetensors")
    file = tmp_path / f"weights{suffix}"
    if container == "torch":
        torch.save(weights, file)
    else:
        save_file({name: value.clone() for name, value in weights.items()}, file)
    checkpoint = read_checkpoint(file)
    assert checkpoint.layout == layout
    assert same(checkpoint.weights, tiny().weights)


@EVERY
def test_weights_are_called_as_in_the_file(tmp_path: Path, layout: Layout):
    name_in_file = read_checkpoint(write(tmp_path, layout)).name_in_file
    block = "backbone.encoder.layer.2.attention.attention"
    assert (
        name_in_file("encoder.network.blocks.2.attn.qkv.weight")
        == {
            "zoedepth": "encoder.network.blocks.2.attn.qkv.weight",
            "original": "core.core.pretrained.model.blocks.2.attn.qkv.weight",
            "huggingface": f"{block}.query.weight/{block}.key.weight/{block}.value.weight",
        }[layout]
    )
    assert name_in_file("surplus") == "surplus"


def test_text_paths_are_taken(tmp_path: Path):
    assert read_checkpoint(str(write(tmp_path, "zoedepth"))).layout == "zoedepth"


def test_folder_without_weights_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=f"{tmp_path} has no model.safetensors$"):
        read_checkpoint(tmp_path)


@pytest.mark.parametrize("name", ["pytorch_model.bin", "ZoeD_M12_N.pt", "last.pth"])
def test_folder_with_other_files_of_weights_hints_at_them(tmp_path: Path, name: str):
    (tmp_path / name).touch()
    with pytest.raises(InputError, match=f"has no model.safetensors; it has '{name}': give the file itself"):
        read_checkpoint(tmp_path)


def test_checkpoint_in_several_files_is_refused(tmp_path: Path):
    (tmp_path / "model.safetensors.index.json").write_text("{}")
    with pytest.raises(InputError, match="in several files"):
        read_checkpoint(tmp_path)


def test_what_is_no_file_is_not_opened(tmp_path: Path):
    """Reading a pipe would wait for ever."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "nothing.pt", tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match=f"there is no file {path}"):
            read_checkpoint(path)


@pytest.mark.parametrize("weights", [{"weight": torch.zeros(3)}, {"layer1.0.conv1.weight": torch.zeros(1)}], ids=str)
def test_weights_of_something_else_are_refused(tmp_path: Path, weights: dict):
    save_file(weights, tmp_path / "file.safetensors")
    with pytest.raises(
        InputError, match=rf"file.safetensors: .* not the weights of a known model.*'{next(iter(weights))}'"
    ):
        read_checkpoint(tmp_path / "file.safetensors")


# --- configs beside the weights ---------------------------------------------------------------------------------------


def strip(file: Path) -> None:
    """Take the texts out of a safetensors file."""
    weights = {name: value.clone() for name, value in load_file(file).items()}
    file.unlink()
    save_file(weights, file)


def test_config_beside_our_weights_does_for_one_within(tmp_path: Path):
    folder = write(tmp_path, "zoedepth")
    strip(folder / "model.safetensors")
    assert read_checkpoint(folder).config == tiny().config
    assert read_checkpoint(folder / "model.safetensors").config == tiny().config


@pytest.mark.parametrize("config", [None, "{}", '{"model_type": "zoedepth"}'])
def test_our_weights_without_a_config_are_refused(tmp_path: Path, config: str | None):
    folder = write(tmp_path, "zoedepth")
    strip(folder / "model.safetensors")
    (folder / "config.json").unlink()
    if config:
        (folder / "config.json").write_text(config)
    with pytest.raises(InputError, match=r"model.safetensors: there is no ZoeDepth config in its metadata"):
        read_checkpoint(folder)


@KINDS
@pytest.mark.parametrize(
    "config",
    [
        None,
        '{"_name_or_path": "x"}',
        '{"model_type": "depth_anything", "bin_configurations": [{"n_bins": 64, "min_depth": 0.1, "max_depth": 99}]}',
    ],
    ids=["none", "of-something-else", "of-another-model"],
)
def test_config_of_transformers_is_told_from_the_shapes_of_a_file_alone_but_a_folder_must_have_it(
    tmp_path: Path, kind: str, config: str | None
):
    folder = write(tmp_path, "huggingface", tiny(kind))
    (folder / "config.json").unlink()
    if config:
        (folder / "config.json").write_text(config)
    assert read_checkpoint(folder / "model.safetensors").config == original.config_of(tiny(kind).weights)
    with pytest.raises(InputError, match=r"the folder has no config.json"):
        read_checkpoint(folder)


def test_size_of_photos_is_that_of_the_preprocessor(tmp_path: Path):
    folder = write(tmp_path, "huggingface")
    file = folder / "preprocessor_config.json"
    values = json.loads(file.read_text())
    file.write_text(json.dumps({**values, "size": {"height": 192, "width": 640}}))
    assert read_checkpoint(folder).config.size == (192, 640)
    file.unlink()
    assert read_checkpoint(folder).config.size == PRESETS["zoed-m12-n"].size


@pytest.mark.parametrize("name", ["config.json", "preprocessor_config.json"])
@pytest.mark.parametrize("content", [b"{", b"\xff", b"[" * 10_000, b"[]", b'{"size": NaN}'], ids=repr)
def test_damaged_config_is_named(tmp_path: Path, name: str, content: bytes):
    folder = write(tmp_path, "huggingface")
    (folder / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"theirs/model.safetensors: .*theirs/{name}: not a JSON object"):
        read_checkpoint(folder)


# --- files that make no model -----------------------------------------------------------------------------------------


def with_config(folder: Path, **changes: Any) -> Path:
    """Our layout, with values put into the config at names like ``encoder__name``."""
    values = to_dict(tiny().config)
    for name, value in changes.items():
        part, _, field = name.rpartition("__")
        (values[part] if part else values)[field] = value
    save_file(tiny().weights, folder / "file.safetensors", metadata={"config": json.dumps(values)})
    return folder / "file.safetensors"


@pytest.mark.parametrize("name", ["hf-hub:owner/name", "hf_hub:owner/name", "local-dir:/etc", "https://x.y/z", "C:x"])
def test_encoder_of_a_config_is_fetched_from_nowhere(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch):
    """timm takes some names for addresses, and asks there before anything else."""
    asked = []
    monkeypatch.setattr("timm.create_model", lambda *_, **__: asked.append(name))
    with pytest.raises(InputError, match=f"file.safetensors makes no model: encoder '{name}'"):
        load_model(with_config(tmp_path, encoder__name=name))
    assert not asked


IMPOSSIBLE = [
    {"encoder__taps": [-1, 1, 2, 3]}, {"encoder__taps": [0, 1, 2, 10**30]}, {"encoder__heads": [0]},
    {"encoder__heads": []}, {"encoder__heads": [10**25]}, {"encoder__width": 0}, {"encoder__width": -1},
    {"encoder__width": 2**40}, {"encoder__width": 10**30}, {"encoder__mlp_width": 10**37},
    {"encoder__mlp_width": 10**400}, {"encoder__depth": [0]}, {"encoder__depth": [10**9]},
    {"encoder__size": [10**18, 10**18]}, {"encoder__size": [0, 0]}, {"encoder__channels": [10**30] * 4},
    {"encoder__name": "resnet50"}, {"encoder__name": "vit_base_patch16_384"}, {"encoder__name": ""},
    {"decoder__features": 10**30}, {"decoder__widths": [2**40] * 4}, {"head__bottleneck_factor": 0},
    {"head__n_bins": 10**12}, {"head__n_bins": 10**30}, {"head__n_attractors": [10**30] * 4},
    {"head__alpha": 10**400}, {"head__alpha": float("nan")}, {"head__gamma": float("inf")},
    {"head__max_temperature": float("inf")}, {"head__seed_width": [[[]]]},
    {"domains": [{"name": "x" * 10**5, "min_depth": 2, "max_depth": 1}]},
    {"domains": [{"name": str(i)} for i in range(1000)]},
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:Initializing zero-element")
@pytest.mark.parametrize("changes", IMPOSSIBLE, ids=lambda changes: str(changes)[:40])
def test_config_that_makes_no_model_is_refused_shortly(tmp_path: Path, changes: dict[str, Any]):
    with pytest.raises(InputError, match=r"file.safetensors") as caught:
        load_model(with_config(tmp_path, **changes))
    assert len(str(caught.value)) < 2500
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("value", [10**400, float("nan"), "1", True, [], None])
@pytest.mark.parametrize("name", ["min_temp", "max_temp"])
def test_numbers_in_a_config_of_transformers_are_numbers(tmp_path: Path, name: str, value: Any):
    folder = write(tmp_path, "huggingface")
    values = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**values, name: value}))
    with pytest.raises(InputError, match=r"theirs/model.safetensors"):
        load_model(folder)


def test_names_in_a_file_cannot_write_to_the_terminal(tmp_path: Path):
    names = ["\x1b[2J", "a\nb", "x" * 100_000]
    weights = tiny().weights | dict.fromkeys(names, torch.zeros(1))
    texts = {"config": json.dumps(to_dict(tiny().config))}
    save_file({name: value.clone() for name, value in weights.items()}, tmp_path / "file.safetensors", metadata=texts)
    with pytest.raises(InputError, match=r"\(3 problems\): unknown \\x1b\[2J; unknown a\\nb; unknown x") as caught:
        load_model(tmp_path / "file.safetensors")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


# Two numbers in a byte came with torch 2.8; bare bits are in every version.
UNCONVERTED = [getattr(torch, name) for name in ("bits8", "float4_e2m1fn_x2") if hasattr(torch, name)]


@pytest.mark.parametrize("kind", UNCONVERTED, ids=str)
def test_weights_that_torch_cannot_convert_are_refused(kind: torch.dtype, tmp_path: Path):
    name = "encoder.network.cls_token"
    packed = torch.zeros(1, 1, 32, dtype=torch.uint8).view(kind)
    theirs = original.write(tiny().config, tiny().weights)
    torch.save(theirs | {"core.core.pretrained.model.cls_token": packed}, tmp_path / "file.pt")
    assert read_checkpoint(tmp_path / "file.pt").weights[name].dtype == packed.dtype
    with pytest.raises(InputError, match=f"mistyped core.core.pretrained.model.cls_token is {kind}"):
        load_model(tmp_path / "file.pt")


@pytest.mark.parametrize(
    "name", ["x" * 300, "x" * 300 + ".pt", "x" * 10_000, "a\0b.pt"], ids=lambda name: repr(name[:10])
)
@pytest.mark.parametrize("kind", [str, Path])
def test_names_that_no_file_can_have_are_no_models(name: str, kind: type):
    with pytest.raises(InputError, match=r"there is no (model named|file) "):
        load_model(kind(name))


# --- there and back ---------------------------------------------------------------------------------------------------


def test_original_that_was_written_here_keeps_what_no_shape_tells(tmp_path: Path):
    checkpoint = tiny("n")
    garden = Domain("garden", 0.1, 40.0, focal_px=900.0, std_factor=1.7)
    own = checkpoint._replace(config=replace(checkpoint.config, domains=(garden,)))
    file = write(tmp_path, "original", own)
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)  # nothing is guessed
        assert load_model(file).config == own.config


@KINDS
def test_all_layouts_in_turn_give_back_the_same_bits(tmp_path: Path, kind: str):
    start = write(tmp_path, "original", tiny(kind))
    checkpoint = read_checkpoint(start)
    for layout in ("zoedepth", "huggingface"):
        checkpoint = read_checkpoint(write(tmp_path, layout, checkpoint))
    assert checkpoint.config == tiny(kind).config
    end = write_checkpoint(checkpoint, tmp_path / "end.pt", to="original")
    assert same(torch.load(end)["model"], torch.load(start)["model"])


@KINDS
def test_model_survives_as_one_file_of_ours(tmp_path: Path, kind: str):
    file = write_checkpoint(tiny(kind), tmp_path / "model.safetensors", to="zoedepth")
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
    checkpoint = read_checkpoint(file)
    assert checkpoint.config == tiny(kind).config
    assert same(checkpoint.weights, tiny(kind).weights)


@torch.no_grad()
@EVERY
def test_loaded_model_computes_the_same(tmp_path: Path, layout: Layout):
    pixels = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    expected = model_of(tiny("k"), source="twin")(pixels).depth
    assert expected.std() > 1e-3, "a constant proves nothing"
    model = load_model(write(tmp_path, layout, tiny("k")))
    assert same(model.state_dict(), model_of(tiny("k"), source="twin").state_dict()), "files keep every bit"
    # Sums may be rounded otherwise: weights that lie elsewhere in memory can take another path of the processor.
    torch.testing.assert_close(model(pixels).depth, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
@EVERY
def test_types_are_kept_in_files_and_become_float32_in_models(tmp_path: Path, layout: Layout, dtype: torch.dtype):
    weights = {name: value.to(dtype) for name, value in tiny().weights.items()}
    path = write(tmp_path, layout, tiny()._replace(weights=weights))
    assert same(read_checkpoint(path).weights, weights)
    model = load_model(path)
    assert same(model.state_dict(), {name: value.float() for name, value in weights.items()})


def test_integers_of_a_network_keep_their_type(tmp_path: Path):
    """Batch norm counts its batches."""
    model = ZoeDepth(PRESETS["zoed-lite"])
    counters = {name: value for name, value in model.state_dict().items() if value.dtype == torch.int64}
    assert counters
    folder = write(tmp_path, "zoedepth", checkpoint_of(model))
    weights = read_checkpoint(folder).weights
    assert same({name: weights[name] for name in counters}, counters)


def test_shared_and_strided_memory_is_written_as_separate_weights(tmp_path: Path):
    square = torch.rand(4, 4)
    weights = {"encoder.a": square, "encoder.b": square, "encoder.c": square[1:], "encoder.d": square.T}
    checkpoint = Checkpoint(tiny().config, weights, "zoedepth", str)
    folder = write(tmp_path, "zoedepth", checkpoint)
    assert same(load_file(folder / "model.safetensors"), weights)


# --- what is written --------------------------------------------------------------------------------------------------


def test_folder_of_ours_has_weights_config_and_card(tmp_path: Path):
    folder = write_checkpoint(tiny(), tmp_path / "deep" / "ours", to="zoedepth", name="owner/name")
    assert {path.name for path in folder.iterdir()} == {"README.md", "config.json", "model.safetensors"}
    assert from_dict(ModelConfig, json.loads((folder / "config.json").read_text())["zoedepth"]) == tiny().config
    assert from_dict(ModelConfig, json.loads(texts_of(folder / "model.safetensors")["config"])) == tiny().config
    assert "# owner/name\n" in (folder / "README.md").read_text(encoding="utf-8")


def test_folder_of_theirs_has_the_config_of_their_processor_too(tmp_path: Path):
    folder = write(tmp_path, "huggingface")
    names = {"README.md", "config.json", "model.safetensors", "preprocessor_config.json"}
    assert {path.name for path in folder.iterdir()} == names
    assert json.loads((folder / "config.json").read_text()) == huggingface_config.to_json(tiny().config, tiny().weights)
    assert texts_of(folder / "model.safetensors") == {"format": "pt"}


def test_file_of_the_original_is_what_its_code_loads(tmp_path: Path):
    saved = torch.load(write(tmp_path, "original"), weights_only=True)
    assert same(saved["model"], original.write(tiny().config, tiny().weights))
    assert [path.name for path in tmp_path.iterdir()] == ["original.pt"]


@EVERY
def test_files_are_readable_as_other_new_files(tmp_path: Path, layout: Layout):
    (tmp_path / "other").touch()
    (tmp_path / "others").mkdir()
    path = write(tmp_path, layout)
    for file in [path, *path.rglob("*")]:
        assert file.stat().st_mode == (tmp_path / ("others" if file.is_dir() else "other")).stat().st_mode


@pytest.mark.parametrize(
    ("layout", "name", "message"),
    [
        ("original", "model", "ends with .pt"),
        ("original", "model.safetensors", "ends with .pt"),
        ("original", "model.bin", "ends with .pt"),
        ("zoedepth", "model.pt", "is a folder: give a name that does not end with .pt"),
        ("zoedepth", "model.pth", "is a folder: give a name that does not end with .pth"),
        ("huggingface", "model.pt", "is a folder: give a name that does not end with .pt"),
        ("huggingface", "model.safetensors", "is a folder: give a name that does not end with .safetensors"),
    ],
)
def test_suffix_of_another_layout_is_refused(tmp_path: Path, layout: Layout, name: str, message: str):
    with pytest.raises(InputError, match=f"{name}: .*{message}"):
        write_checkpoint(tiny(), tmp_path / name, to=layout)
    assert list(tmp_path.iterdir()) == []


FOLDERS = pytest.mark.parametrize("layout", ["zoedepth", "huggingface"])


def occupy_with_file(path: Path) -> None:
    path.write_text("mine")


def occupy_with_folder(path: Path) -> None:
    path.mkdir()
    (path / "mine").write_text("mine")


def occupy_with_link(path: Path) -> None:
    (path.parent / "empty").mkdir()
    path.symlink_to(path.parent / "empty")


def occupy_with_dangling_link(path: Path) -> None:
    path.symlink_to(path.parent / "nothing")


@pytest.mark.parametrize(
    "occupy",
    [occupy_with_file, occupy_with_folder, occupy_with_link, occupy_with_dangling_link],
    ids=lambda x: x.__name__,
)
@FOLDERS
def test_folder_that_is_there_already_is_refused(tmp_path: Path, layout: Layout, occupy: Callable[[Path], None]):
    path = tmp_path / TARGETS[layout]
    occupy(path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=f"{path} is there already"):
        write(tmp_path, layout)
    assert sorted(tmp_path.rglob("*")) == before


@FOLDERS
def test_folder_we_are_in_is_not_replaced(tmp_path: Path, layout: Layout, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="is there already"):
        write_checkpoint(tiny(), ".", to=layout)
    assert list(tmp_path.iterdir()) == []


@FOLDERS
def test_empty_folder_is_filled(tmp_path: Path, layout: Layout):
    (tmp_path / TARGETS[layout]).mkdir()
    assert read_checkpoint(write(tmp_path, layout)).layout == layout


def test_file_that_is_there_already_is_replaced(tmp_path: Path):
    for layout, name in (("original", "model.pt"), ("zoedepth", "model.safetensors")):
        (tmp_path / name).write_text("old")
        assert read_checkpoint(write_checkpoint(tiny(), tmp_path / name, to=layout)).layout == layout


@pytest.mark.parametrize("layout", ["original", "huggingface"])
def test_model_that_a_layout_has_not_leaves_nothing(tmp_path: Path, layout: Layout):
    with pytest.raises(InputError, match="has no such model"):
        write(tmp_path, layout, checkpoint_of(ZoeDepth(PRESETS["zoed-lite"])))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("layout", "name"),
    [("original", "model.pt"), ("zoedepth", "model.safetensors"), ("zoedepth", "folder"), ("huggingface", "folder")],
)
def test_writing_that_fails_half_way_leaves_nothing_new_and_nothing_broken(tmp_path: Path, layout: Layout, name: str):
    """The disk takes no more than a part of the weights; a file that was there stays as it was."""
    if name != "folder":
        (tmp_path / name).write_text("old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, limits[1]))
    try:
        # OSError, or what safetensors and torch make of it
        with pytest.raises(Exception, match=r"(?i)too large|i/o|write|pos"):
            write_checkpoint(tiny(), tmp_path / name, to=layout)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == ([] if name == "folder" else [name])
    assert name == "folder" or (tmp_path / name).read_text() == "old"
