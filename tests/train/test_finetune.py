"""Fine-tuning on somebody's own data: what is chosen, what comes out."""

import dataclasses
import json
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_pairs
from tests.train.runs import write_sparse
from torch import nn
from torch.utils.data import Subset

from zoedepth.cli import main
from zoedepth.commands.train import _described
from zoedepth.config import EncoderConfig, ModelConfig
from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.evaluation.dataset_scores import score_dataset
from zoedepth.evaluation.predictions import ModelSource
from zoedepth.evaluation.protocols import INDOOR
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.provenance import Provenance
from zoedepth.train import finetune as module
from zoedepth.train.config import FinetuneOptions, TrainConfig
from zoedepth.train.finetune import Plan, plan, steps_for
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model


@pytest.fixture
def init(tiny_model: ZoeDepth, tmp_path: Path) -> str:
    """A two-domain model to start from."""
    path = tmp_path / "init.safetensors"
    tiny_model.provenance = Provenance("non-commercial research", "NYU", {"nyu": {"rel": 0.5}})
    save_model(tiny_model, path)
    return str(path)


@pytest.fixture(autouse=True)
def read_by_the_test_itself() -> Iterator[None]:
    """Read photos in this process: to start others takes longer than to train a few steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "TrainConfig", partial(TrainConfig, n_workers=0))
        yield


@pytest.fixture
def planned(init: str, tmp_path: Path):
    """Return a function that plans with options of ``FinetuneOptions``; data are keywords NAME → path."""

    def make(data: dict[str, Path], **options: object) -> Plan:
        named = {name: str(path) for name, path in data.items()}
        return plan(named, FinetuneOptions(**{"init": init, **options}), out=tmp_path / "out")

    return make


# ---------------------------------------------------------------------------------------------------- the plan


def test_plan_fits_the_data(planned, tmp_path: Path, tiny_config: ModelConfig):
    chosen = planned({"rooms": write_pairs(tmp_path / "rooms", n=20)})
    config = chosen.config
    assert config.model == tiny_config
    assert config.holdout == 2
    assert [source.name for source in config.sources] == ["rooms"]
    assert not config.sources[0].sparse
    assert config.steps == 40 * 18 // 4  # 40 epochs of the 18 pairs that are left, 4 at once
    assert config.validate_every == config.steps // 5
    assert config.optim.learning_rate == 1.61e-4
    # Data of one known domain teaches the router nothing.
    assert config.domain_weight == 0
    assert (chosen.new_domains, chosen.unseen_domains) == ((), ("outdoor",))
    with Image.open(tmp_path / "out/data.jpg") as picture:
        assert picture.size[0] > 2 * 320  # photo and depth


def test_options_go_before_what_the_data_suggests(planned, init: str, tmp_path: Path):
    rooms = write_pairs(tmp_path / "rooms", n=8)
    options = {"holdout": 3, "steps": 7, "batch_size": 5, "learning_rate": 0.5, "seed": 9}
    config = planned({"rooms": rooms}, **options).config
    found = (config.holdout, config.steps, config.batch_size, config.optim.learning_rate, config.seed)
    assert found == tuple(options.values())
    rooms.write_text("\n".join(line.rsplit(",", 2)[0] for line in rooms.read_text().splitlines()) + "\n")
    rooms = rooms.rename(tmp_path / "list.csv")
    given = {"domain": "attic", "depth_scale": 500.0, "root": str(tmp_path / "rooms")}
    (source,) = planned({"rooms": rooms}, **given).config.sources
    assert (source.domain, source.depth_scale, source.root) == tuple(given.values())
    with pytest.raises(InputError, match="steps and batch_size must be at least 1; they are 0"):
        planned({"rooms": rooms}, **given, steps=0)


def test_start_and_length_may_be_given_without_other_options(init: str, tmp_path: Path):
    rooms = {"rooms": str(write_pairs(tmp_path / "rooms", n=8))}
    chosen = plan(rooms, init=init, steps=3, out=tmp_path / "out")
    assert chosen.config.steps == 3
    assert plan(rooms, FinetuneOptions(init="none", steps=9, seed=5), init=init, out=tmp_path / "out").config.seed == 5


def test_more_data_means_fewer_epochs():
    assert steps_for(30, 4) == 300
    assert steps_for(4, 4) == 100
    assert steps_for(1000, 4) == pytest.approx(40 * (30 / 1000) ** 0.4 * 250, rel=0.01)
    assert steps_for(24231, 16) == round(5 * 24231 / 16)  # the paper's five epochs


def test_router_is_trained_where_there_is_something_to_tell_apart(planned, tmp_path: Path):
    rooms = write_pairs(tmp_path / "rooms", n=2)
    streets = write_pairs(tmp_path / "streets", n=3, domain="outdoor")
    both = planned({"rooms": rooms, "streets": streets})
    assert both.config.domain_weight == 1
    assert both.config.batch_size == 3  # as many as are left
    assert (both.new_domains, both.unseen_domains) == ((), ())
    more = planned({"rooms": rooms, "streets": write_pairs(tmp_path / "more", n=14, domain="outdoor")})
    # Each is measured on as many of its own as it can spare.
    held_out = [more.config.held_out(source.name) for source in more.config.sources]
    assert sorted(held_out) == [1, 2]
    assert len(more.config.holdouts) == 2
    new = planned({"lidar": write_sparse(tmp_path / "lidar")})
    assert new.config.domain_weight == 1
    assert new.config.sources[0].sparse
    assert [(domain.name, domain.max_depth) for domain in new.config.model.domains] == [
        ("indoor", 10), ("outdoor", 80), ("warehouse", 8),
    ]  # fmt: skip
    assert (new.new_domains, new.unseen_domains) == (("warehouse",), ("indoor", "outdoor"))


def test_convolutional_encoders_take_larger_rates(planned, tiny_config: ModelConfig, tmp_path: Path):
    encoder = EncoderConfig("tf_efficientnet_lite0", "convolutional", size=(224, 224))
    save_model(ZoeDepth(dataclasses.replace(tiny_config, encoder=encoder)), tmp_path / "lite.safetensors")
    chosen = planned({"rooms": write_pairs(tmp_path / "rooms")}, init=str(tmp_path / "lite.safetensors"))
    assert chosen.config.optim.learning_rate == 3e-4


def test_models_that_cannot_be_fine_tuned_are_errors(
    planned, tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    rooms = write_pairs(tmp_path / "rooms")
    save_model(ZoeDepth(dataclasses.replace(tiny_config, domains=())), tmp_path / "relative.safetensors")
    with pytest.raises(InputError, match=r"relative\.safetensors gives relative depth only"):
        planned({"rooms": rooms}, init=str(tmp_path / "relative.safetensors"))
    monkeypatch.setattr(module, "load_network", lambda name: nn.Module())
    with pytest.raises(InputError, match="bts-n is a baseline"):
        planned({"rooms": rooms}, init="bts-n")


def test_too_few_pairs_are_an_error(planned, tmp_path: Path):
    with pytest.raises(InputError, match="a holdout of 1 leaves none"):
        planned({"rooms": write_pairs(tmp_path / "rooms", n=1)})


# ---------------------------------------------------------------------------------------------------- cameras


def in_one_camera(tiny_model: ZoeDepth, tmp_path: Path, *, canonical: bool = True) -> str:
    """Save a model whose metres are those of one camera: 50 pixels indoors and 100 outdoors, at 64 x 64."""
    config = tiny_model.config
    domains = tuple(
        dataclasses.replace(each, focal_px=focal) for each, focal in zip(config.domains, (50.0, 100.0), strict=True)
    )
    model = ZoeDepth(dataclasses.replace(config, domains=domains, canonical_camera=canonical))
    model.load_state_dict(tiny_model.state_dict())
    save_model(model, tmp_path / "camera.safetensors")
    return str(tmp_path / "camera.safetensors")


def test_model_learns_the_lens_of_the_data_unless_it_is_in_one_camera(planned, tiny_model: ZoeDepth, tmp_path: Path):
    """Photos of 64 x 64, as the network sees them; the median of 40, 60 and 90 pixels is 60."""
    init = in_one_camera(tiny_model, tmp_path, canonical=False)
    known = write_pairs(tmp_path / "known", n=3, size=(64, 64), focal_px=(40.0, 90.0, 60.0))
    config = planned({"known": known}, init=init).config
    assert [domain.focal_px for domain in config.model.domains] == [60.0, 100.0]
    assert not config.model.canonical_camera
    some = write_pairs(tmp_path / "some", n=3, size=(64, 64), focal_px=(40.0, 60.0))
    config = planned({"known": known, "some": some}, init=init).config
    assert [domain.focal_px for domain in config.model.domains] == [None, 100.0], "one lens is unknown"
    assert {source.without_camera for source in config.sources} == {"refuse"}


def test_depth_is_scaled_where_the_model_is_in_one_camera(planned, tiny_model: ZoeDepth, tmp_path: Path):
    init = in_one_camera(tiny_model, tmp_path)
    # Up to 5 m through a lens of 10 pixels: 25 m of the camera of 50 pixels. The halls start from the indoor head.
    wide = write_pairs(tmp_path / "wide", n=3, size=(64, 64), focal_px=(10.0, 20.0, 10.0))
    halls = write_pairs(tmp_path / "halls", n=3, size=(64, 64), focal_px=(25.0,) * 3)
    halls.write_text(halls.read_text().replace(",indoor", ",hall"))
    bare = write_pairs(tmp_path / "bare", n=3, size=(64, 64), domain="outdoor")
    chosen = planned({"wide": wide, "halls": halls, "bare": bare}, init=init)
    assert [(each.name, each.max_depth, each.focal_px) for each in chosen.config.model.domains] == [
        ("indoor", 30.0, 50.0), ("outdoor", 80.0, 100.0), ("hall", 10.0, 50.0),
    ]  # fmt: skip
    assert {source.name: source.without_camera for source in chosen.config.sources} == {
        "wide": "refuse", "halls": "refuse", "bare": "assume",
    }  # fmt: skip
    said = "\n".join(_described(chosen, tmp_path))
    assert "wide: cameras of 116 to 145 degrees from left to right; depth is scaled to the canonical one" in said
    assert "bare: no camera is known: all photos are taken to come from the canonical one" in said
    some = write_pairs(tmp_path / "some", n=3, focal_px=(40.0,))
    with pytest.raises(InputError, match=r"some says the camera of 1 of the 3 photos .* for all of them.* or for none"):
        planned({"some": some}, init=init)


def test_before_and_after_are_measured_with_the_camera(tiny_model: ZoeDepth, tmp_path: Path):
    init, out = in_one_camera(tiny_model, tmp_path), tmp_path / "out"
    path = write_pairs(tmp_path / "rooms", n=2, size=(64, 64), focal_px=(25.0, 25.0))
    assert main(["train", "finetune", "--data", str(path), "--init", init, "--steps", "1", "--out", str(out)]) == 0
    (measured,) = json.loads((out / "metrics.json").read_text()).values()
    assert [measured[label]["camera"] for label in ("before", "after")] == ["data", "data"]
    dataset = PairDataset(path)
    held_out, protocols = Subset(dataset, [1]), {"indoor": INDOOR}
    expected = score_dataset(ModelSource(load_model(init), camera="data"), held_out, protocols).scores[0].sums.metrics()
    assert measured["before"]["metrics"]["rel"] == pytest.approx(expected.rel)
    assert load_model(out / "model.safetensors").config == load_model(init).config


# ---------------------------------------------------------------------------------------------------- the command


def test_finetuning_writes_a_better_model_its_card_and_the_comparison(init: str, tmp_path: Path, capsys):
    path = write_pairs(tmp_path / "rooms", n=6, size=(96, 128))
    out = tmp_path / "out"
    arguments = ["train", "finetune", "--data", f"rooms={path}", "--init", init, "--out", str(out), "--steps", "28"]
    assert main([*arguments, "--learning-rate", "0.008", "--holdout", "2"]) == 0
    printed = capsys.readouterr()
    assert "6 pairs, 128x96; depth known at 88% (dense)" in printed.err
    assert "before" in printed.out
    assert "after" in printed.out
    assert printed.out.splitlines()[-1] == str(out / "model.safetensors")
    measured = json.loads((out / "metrics.json").read_text())["rooms"]
    assert measured["before"]["n_scored"] == measured["after"]["n_scored"] == 2
    assert {"calibration", "boundary_f1"} <= measured["after"].keys()  # the names that files have had from the start
    # How much better depends on the first random numbers: 0.95 times with torch 2.6, less than 0.9 with 2.14.
    assert measured["after"]["metrics"]["rel"] < 0.97 * measured["before"]["metrics"]["rel"]
    assert load_model(out / "model.safetensors").config == load_model(init).config
    card = (out / "README.md").read_text()
    assert "rooms (4 pairs)" in card
    # Terms and training data are inherited, numbers are measured anew.
    assert "license_name: non-commercial-research\n" in card
    about = load_model(out / "model.safetensors").provenance
    assert about.licence == "non-commercial research"
    assert about.trained_on == "rooms (4 pairs); before that: NYU"
    assert [name.partition(" (")[0] for name in about.measured] == ["rooms"]
    assert f"{measured['after']['metrics']['rel']:.3f}" in card

    # Again: everything is there, nothing is trained, the result is the same.
    kept = [out / name for name in ("run/log.jsonl", "run/step_000028/train.pt", "metrics.json", "README.md")]
    before = [file.read_bytes() for file in kept]
    (out / "model.safetensors").unlink()
    assert main([*arguments, "--learning-rate", "0.008", "--holdout", "2"]) == 0
    assert [file.read_bytes() for file in kept] == before
    assert load_model(out / "model.safetensors").config == load_model(init).config


def test_third_domain_of_scattered_depth_is_added_and_learned(init: str, tmp_path: Path, capsys):
    path, out = write_sparse(tmp_path / "lidar", n=4), tmp_path / "out"
    arguments = ["train", "finetune", "--data", f"lidar={path}", "--init", init, "--out", str(out), "--steps", "30"]
    assert main([*arguments, "--learning-rate", "0.01", "--holdout", "1"]) == 0
    error = capsys.readouterr().err
    assert "(scattered points)" in error
    assert "There is no photo of indoor, outdoor in the data" in error
    model = load_model(out / "model.safetensors")
    assert [domain.name for domain in model.config.domains] == ["indoor", "outdoor", "warehouse"]
    measured = json.loads((out / "metrics.json").read_text())["lidar"]
    assert measured["after"]["router"] == 1
    assert measured["after"]["metrics"]["rel"] < measured["before"]["metrics"]["rel"]


def test_router_that_is_wrong_about_the_photos_is_trained_after_all(tiny_model: ZoeDepth, init: str, tmp_path: Path):
    with torch.no_grad():  # a router that sends all photos to the indoor head
        tiny_model.router.classifier.mlp[-1].weight.zero_()
        tiny_model.router.classifier.mlp[-1].bias.copy_(torch.tensor([1.0, 0.0]))
    save_model(tiny_model, Path(init))
    weights = {}
    for domain in ("indoor", "outdoor"):
        path = write_pairs(tmp_path / domain, n=2, domain=domain)
        out = tmp_path / f"out-{domain}"
        assert main(["train", "finetune", "--data", str(path), "--init", init, "--steps", "1", "--out", str(out)]) == 0
        (measured,) = json.loads((out / "metrics.json").read_text()).values()
        config = json.loads((out / "run/step_000001/meta.json").read_text())["config"]
        weights[domain] = (measured["before"]["router"], config["domain_weight"])
    assert weights == {"indoor": (1, 0), "outdoor": (0, 1)}


def test_unit_and_domain_that_the_data_does_not_say_are_given(init: str, tmp_path: Path, capsys):
    for index in range(3):
        for folder, picture in (
            ("images", np.zeros((48, 64, 3), np.uint8)),
            ("depth", np.full((48, 64), 500, np.uint16)),
        ):
            (tmp_path / "mine" / folder).mkdir(parents=True, exist_ok=True)
            Image.fromarray(picture).save(tmp_path / f"mine/{folder}/{index}.png")
    arguments = ["train", "finetune", "--data", str(tmp_path / "mine"), "--init", init, "--steps", "1"]
    assert main([*arguments, "--out", str(tmp_path / "a"), "--domain", "attic"]) == 2  # 500 of what?
    assert "depth_scale" in capsys.readouterr().err
    arguments += ["--depth-scale", "200", "--domain", "attic", "--out", str(tmp_path / "b")]
    assert main(arguments) == 0
    assert "attic 2.50 to 2.5 m" in capsys.readouterr().err
    assert [domain.name for domain in load_model(tmp_path / "b/model.safetensors").config.domains][2] == "attic"


# ---------------------------------------------------------------------------------------------------- old results


def folder_of_pairs(folder: Path, n: int = 12, scale: float = 1000, **facts: object) -> Path:
    """Write a folder of pairs, whose depth is 0.5 to 4 m in millimetres, and what ``dataset.json`` says."""
    write_pairs(folder, n=n, size=(48, 64))
    (folder / "train.csv").unlink()
    (folder / "dataset.json").write_text(json.dumps({"domain": "indoor", "depth_scale": scale, **facts}))
    return folder


def test_depth_beyond_a_kilometre_is_refused_unless_it_is_believed(planned, tmp_path: Path):
    rooms = folder_of_pairs(tmp_path / "rooms", scale=0.001)
    with pytest.raises(InputError, match=r"rooms: the median depth of its indoor photos is \S+e\+06 m.*--check off"):
        planned({"rooms": rooms})
    assert not (tmp_path / "out").exists()
    assert planned({"rooms": rooms}, check="off").surveys["rooms"].far["indoor"] > 1e6


def test_holes_stored_as_the_largest_number_are_unknown_in_training_too(planned, tmp_path: Path):
    rooms = folder_of_pairs(tmp_path / "rooms")
    for path in (rooms / "depth").iterdir():
        stored = np.array(Image.open(path))
        stored[:9] = 65535
        Image.fromarray(stored).save(path)
    chosen = planned({"rooms": rooms})
    assert chosen.config.sources[0].max_depth == 65.53
    assert [domain.max_depth for domain in chosen.config.model.domains] == [10, 80]
    sample = module.open_source(chosen.config.sources[0], rooms)[0]
    assert sample.target[sample.mask].max() <= 5
    told = "\n".join(_described(chosen, tmp_path / "out"))
    assert "hold the largest value, 65.535 m" in told
    assert "It is taken for unknown from 65.53 m on." in told


def test_broken_pairs_are_named_and_left_out_up_to_a_tenth(planned, tmp_path: Path):
    rooms = folder_of_pairs(tmp_path / "rooms", n=20)
    for index in (3, 11):
        photo = rooms / f"image/train_{index:03d}.jpg"
        photo.write_bytes(photo.read_bytes()[:300])
    chosen = planned({"rooms": rooms})
    assert list(chosen.broken["rooms"]) == [3, 11]
    assert "rooms: skipped: " in "\n".join(_described(chosen, tmp_path / "out"))
    (rooms / "image/train_005.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"3 of 20 pairs of \S*rooms cannot be read, more than a tenth:"):
        planned({"rooms": rooms})


@pytest.mark.parametrize("name", ["README.md", "metrics.json", "model.safetensors", "data.jpg"])
def test_files_that_are_not_ours_are_never_replaced(planned, tmp_path: Path, name: str):
    rooms = folder_of_pairs(tmp_path / "rooms")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    with pytest.raises(InputError, match=f"out has {name}, and no fine-tuning has written it"):
        planned({"rooms": rooms})
    assert [path.name for path in (tmp_path / "out").iterdir()] == [name]


def test_the_folder_of_the_data_is_not_written_to(init: str, tmp_path: Path):
    rooms = folder_of_pairs(tmp_path / "rooms")
    before = sorted(rooms.rglob("*"))
    for path in (rooms, tmp_path / "rooms/../rooms"):
        with pytest.raises(InputError, match="is the folder of the data"):
            plan({"rooms": str(rooms)}, FinetuneOptions(init=init), out=path)
    assert sorted(rooms.rglob("*")) == before


def test_a_result_belongs_to_its_data_its_options_and_its_weights(
    init: str, tiny_model: ZoeDepth, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """Nothing is measured or trained before that is found out, and a finished one can be lengthened."""
    rooms, out = folder_of_pairs(tmp_path / "rooms", n=3), tmp_path / "out"
    arguments = ["train", "finetune", "--data", str(rooms), "--init", init, "--out", str(out), "--holdout", "1"]
    assert main([*arguments, "--steps", "1"]) == 0
    names = ("README.md", "metrics.json", "data.jpg", "initial.safetensors")
    kept = {path: path.read_bytes() for path in (out / name for name in names)}
    monkeypatch.setattr(module, "_measure", None)

    def refused(*changes: str) -> str:
        capsys.readouterr()
        assert main([*arguments, "--steps", "1", *changes]) == 2
        assert all(path.read_bytes() == content for path, content in kept.items())
        (line,) = [line for line in capsys.readouterr().err.splitlines() if "differ" in line]
        return line

    assert "['optim']" in refused("--learning-rate", "0.1")
    depth = rooms / "depth/train_000.png"
    content, times = depth.read_bytes(), depth.stat()
    depth.write_bytes(content + b"\0")
    assert "Files of the data, or what is said of them, have changed since" in refused()
    depth.write_bytes(content)
    os.utime(depth, ns=(times.st_atime_ns, times.st_mtime_ns))
    with torch.no_grad():
        next(tiny_model.parameters()).add_(1)
    before = Path(init).read_bytes()
    save_model(tiny_model, Path(init))
    assert "other starting weights" in refused()
    Path(init).write_bytes(before)
    monkeypatch.undo()
    arguments[3] += "/"  # which shells add
    assert main([*arguments, "--steps", "2"]) == 0
    assert (out / "run/step_000002").is_dir()
