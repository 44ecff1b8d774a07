"""``zoedepth train``: recipes by name, every field from the command line, and the folder of the run."""

import json
import re
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import NoReturn

import pytest
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.cli import main
from zoedepth.config import BaselineConfig, ModelConfig, NaiveConfig, PixelBinsConfig
from zoedepth.errors import InputError
from zoedepth.presets import ENCODERS
from zoedepth.recipes import RECIPES
from zoedepth.train.config import FinetuneOptions, SourceConfig, TrainConfig
from zoedepth.train.finetune import Plan
from zoedepth.weights.load import load_model


@pytest.fixture
def tiny_recipe(monkeypatch: pytest.MonkeyPatch, tiny_config: ModelConfig) -> Callable[[str], None]:
    """Adds the recipe "tiny" of a stage."""

    def add(stage: str) -> None:
        config = TrainConfig(
            stage=stage,
            model=tiny_config,
            sources=(SourceConfig("indoor"), SourceConfig("outdoor"), SourceConfig("relative")),
            steps=100,
            batch_size=2,
            precision="32-true",
            n_workers=0,
            seed=3,
        )
        monkeypatch.setitem(RECIPES, "tiny", lambda: config)

    return add


Trained = tuple[TrainConfig, str | None]


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch) -> list[Trained]:
    """(configuration, starting weights) of what would be trained. recipes/ trains them."""
    found: list[Trained] = []

    def train_metric(config: TrainConfig, *, out: Path, init: str | None, **_: object) -> Path:
        found.append((config, init))
        return out

    monkeypatch.setattr("zoedepth.train.metric.train_metric", train_metric)
    return found


def saved_config(checkpoint: Path) -> dict:
    return json.loads((checkpoint / "meta.json").read_text())["config"]


def test_fields_of_the_recipe_are_overridden_and_the_last_checkpoint_is_printed(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_recipe("metric")
    indoor = write_pairs(tmp_path / "indoor", n=2)
    write_pairs(tmp_path / "street", n=1, domain="outdoor")
    out = tmp_path / "out"
    arguments = ["train", "tiny", "--data", f"indoor={indoor}", f"outdoor={tmp_path / 'street'}", "--out", str(out)]
    overrides = [
        "--config.steps", "2", "--config.optim.learning-rate", "0.002", "--config.ema-decay", "0.5",
        "--config.no-route-by-label", "--config.model.head.alpha", "1.5",
    ]  # fmt: skip

    assert main([*arguments, *overrides]) == 0

    last = out / "step_000002"
    assert capsys.readouterr().out.splitlines()[-1] == str(last)
    config = saved_config(last)
    assert config["steps"] == 2
    assert config["optim"]["learning_rate"] == 0.002
    assert config["ema_decay"] == 0.5
    assert config["route_by_label"] is False
    assert config["batch_size"] == 2
    assert load_model(last).config.head.alpha == 1.5


@pytest.mark.parametrize(
    ("options", "head"),
    [
        (["--head", "pixelbins", "--config.model.head.n-bins", "5"], PixelBinsConfig(n_bins=5)),
        (["--head=naive"], NaiveConfig()),
        (["--config.model.head.kind", "exponential", "--head", "attractor"], "exponential"),
    ],
)
def test_head_is_chosen_and_its_own_fields_are_overridden(
    tiny_recipe: Callable[[str], None], tmp_path: Path, trained: list[Trained], options: list[str], head: object
) -> None:
    tiny_recipe("metric")
    assert main(["train", "tiny", "--data", "a=b", "--out", str(tmp_path / "out"), *options]) == 0
    ((config, _),) = trained
    found = config.model.head
    if isinstance(head, str):  # the recipe's own head, but for that field
        assert found == replace(RECIPES["tiny"]().model.head, kind=head)
    else:
        assert found == head


def test_encoder_is_chosen(tiny_recipe: Callable[[str], None], tmp_path: Path, trained: list[Trained]) -> None:
    tiny_recipe("metric")
    arguments = ["train", "tiny", "--data", "a=b", "--out", str(tmp_path / "out")]
    assert main([*arguments, "--encoder", "tf_efficientnet_lite1", "--init", "imagenet"]) == 0
    ((config, init),) = trained
    assert (config.model.encoder, init) == (ENCODERS["tf_efficientnet_lite1"], "imagenet")


@pytest.mark.parametrize(
    ("recipe", "options", "message"),
    [
        ("tiny", ["--head", "bins"], "there is no head 'bins': did you mean"),
        ("tiny", ["--encoder", "resnet18"], "there is no encoder 'resnet18'"),
        ("bts_n", ["--head", "naive"], "a baseline's head cannot be changed"),
    ],
)
def test_parts_there_are_not_are_errors(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str], recipe: str,
    options: list[str], message: str,
) -> None:  # fmt: skip
    tiny_recipe("metric")
    assert main(["train", recipe, "--data", "nyu=x", "--out", str(tmp_path / "out"), *options]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_baseline_is_trained_gone_on_with_and_evaluated_by_the_same_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rooms = write_pairs(tmp_path / "rooms", n=2)
    arguments = ["train", "comparison_pixelbins", "--data", f"nyu={rooms}", "--out", str(tmp_path / "out")]
    small = ["--config.model.size", "64", "96", "--config.batch-size", "2", "--config.n-workers", "0"]
    assert main([*arguments, *small, "--init", "imagenet", "--config.steps", "2"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert main([*arguments, *small, "--config.steps", "2"]) == 2, "it began with other weights"
    assert "['init'] differ" in capsys.readouterr().err
    assert main([*arguments, *small, "--init", "imagenet", "--config.steps", "2"]) == 0, "there is nothing left to do"
    model = load_model(last)
    assert isinstance(model.config, BaselineConfig)
    assert model.config.size == (64, 96)
    capsys.readouterr()
    assert main(["evaluate", "--model", last, "--data", f"rooms={rooms}", "--json", "--crop", "none"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["images"] == 2
    assert scores["rel"] > 0


def test_first_stage_result_starts_the_second(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_recipe("relative")
    stills = write_disparity_pairs(tmp_path / "relative", n=1)
    arguments = ["train", "tiny", "--config.steps", "1"]
    assert main([*arguments, "--data", str(stills), "--out", str(tmp_path / "first")]) == 0
    tiny_recipe("metric")
    indoor = write_pairs(tmp_path / "indoor", n=1)
    first = tmp_path / "first" / "step_000001"
    second = ["--data", str(indoor), "--out", str(tmp_path / "second"), "--init", str(first)]
    assert main([*arguments, *second]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [str(first), str(tmp_path / "second/step_000001")]
    assert f"metric from all weights of {first}" in printed.err.replace("\n", "")


def test_typed_again_the_run_goes_on_and_with_other_values_it_is_refused(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_recipe("metric")
    indoor = write_pairs(tmp_path / "indoor", n=1)
    arguments = ["train", "tiny", "--data", str(indoor), "--out", str(tmp_path / "out"), "--config.steps"]
    assert main([*arguments, "1"]) == 0
    before = (tmp_path / "out" / "step_000001" / "train.pt").read_bytes()
    capsys.readouterr()
    assert main([*arguments, "1"]) == 0
    assert (tmp_path / "out" / "step_000001" / "train.pt").read_bytes() == before
    assert "has taken all of its 1 steps: there is nothing left to train" in capsys.readouterr().err
    assert main([*arguments, "1", "--config.seed", "4"]) == 2
    assert "['seed']" in capsys.readouterr().err
    assert main([*arguments, "2"]) == 0, "a finished run can be lengthened"
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "out/step_000002")
    assert main([*arguments, "1"]) == 2
    assert "none be shortened" in capsys.readouterr().err
    indoor.write_text(indoor.read_text() + "\n")  # the list is the same, its pairs are: nothing has changed
    assert main([*arguments, "2"]) == 0
    (tmp_path / "indoor/dataset.json").write_text('{"max_depth": 4}')
    assert main([*arguments, "2"]) == 2
    assert "Files of the data, or what is said of them, have changed since" in capsys.readouterr().err


@pytest.mark.parametrize("stage", ["metric", "relative"])
@pytest.mark.parametrize(("options", "expected"), [([], (None, 1)), (["--devices", "2", "--nodes", "3"], (2, 3))])
def test_processes_and_machines_arrive(
    tiny_recipe: Callable[[str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str,
    options: list[str], expected: tuple[int | None, int],
) -> None:  # fmt: skip
    tiny_recipe(stage)
    asked = []

    def train_stage(config: TrainConfig, *, out: Path, devices: int | None, n_nodes: int, **_: object) -> Path:
        asked.append((config.stage, devices, n_nodes))
        return out

    monkeypatch.setattr(f"zoedepth.train.{stage}.train_{stage}", train_stage)
    assert main(["train", "tiny", "--data", "indoor=a", "--out", str(tmp_path / "out"), *options]) == 0
    assert asked == [(stage, *expected)]


@pytest.mark.parametrize(("rank", "lines"), [(0, 1), (1, 0)])
def test_the_first_of_several_processes_prints_the_checkpoint(
    tiny_recipe: Callable[[str], None], trained: list[Trained], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], rank: int, lines: int,
) -> None:  # fmt: skip
    tiny_recipe("metric")
    monkeypatch.setattr("zoedepth.train.processes.several_processes", lambda: True)
    monkeypatch.setattr("torch.distributed.get_rank", lambda: rank)
    assert main(["train", "tiny", "--data", "indoor=a", "--out", str(tmp_path / "out")]) == 0
    assert len(trained) == 1
    assert len(capsys.readouterr().out.splitlines()) == lines


@pytest.mark.parametrize("arguments", [["--help"], ["-h"]])
def test_help_lists_the_recipes(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", *arguments]) == 0
    output = capsys.readouterr().out
    assert all(name in output for name in RECIPES)


def one_of_each() -> dict[str, str]:
    """Return one recipe for each class of head and of baseline: their fields differ, all others are the same."""
    found = {}
    for name, make in RECIPES.items():
        model = make().model
        part = model.network if isinstance(model, BaselineConfig) else model.head
        found.setdefault(type(part), name)
    return found


@pytest.mark.parametrize(("part", "name"), one_of_each().items())
def test_help_of_a_recipe_lists_its_fields(part: type, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["train", name, "--help"])
    assert stopped.value.code == 0
    output = capsys.readouterr().out
    for option in ("--data", "--out", "--init", "--config.steps", "--config.optim.learning-rate"):
        assert option in output
    for field in fields(part):
        assert f".{field.name.replace('_', '-')}" in output


def test_without_a_recipe_it_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train"]) == 2
    output = capsys.readouterr()
    assert all(name in output.out + output.err for name in RECIPES)


def test_wrong_recipe_data_and_start_are_errors_in_one_line(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_recipe("metric")
    indoor = write_pairs(tmp_path / "indoor", n=1)
    out = ["--out", str(tmp_path / "out"), "--config.steps", "1"]

    def error(*arguments: str) -> str:
        assert main(["train", *arguments]) == 2
        return capsys.readouterr().err

    assert "'tinny'" in error("tinny", "--data", str(indoor), *out)
    assert "nyu" in error("tiny", "--data", f"nyu={indoor}", *out)
    assert "nowhere" in error("tiny", "--data", f"indoor={tmp_path / 'nowhere'}", *out)
    assert "zoed-light" in error("tiny", "--data", str(indoor), *out, "--init", "zoed-light")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--no-such-flag", "1"],
        ["--config.no-such-field", "1"],
    ],
)
def test_unknown_flags_are_errors_that_name_them(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    tiny_recipe("metric")
    assert main(["train", "tiny", "--data", "a=b", "--out", str(tmp_path / "out"), *arguments]) == 2
    assert arguments[0] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [["--config.steps", "many"], ["--config.stage", "both"]])
def test_wrong_values_are_errors_that_name_them(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    tiny_recipe("metric")
    with pytest.raises(SystemExit) as stopped:
        main(["train", "tiny", "--data", "a=b", "--out", str(tmp_path / "out"), *arguments])
    assert stopped.value.code == 2
    assert arguments[0] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_value_that_makes_no_sense_is_an_error_that_says_why(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_recipe("metric")
    with pytest.raises(SystemExit) as stopped:
        main(["train", "tiny", "--data", "a=b", "--out", str(tmp_path / "out"), "--config.steps", "0"])
    assert stopped.value.code == 2
    assert "steps and batch_size" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("others", [[], ["--config.no-route-by-label"], ["--config.domain-weight", "0"]])
def test_an_auto_router_is_given_no_labels(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str], others: list[str]
) -> None:
    tiny_recipe("metric")
    words = ["train", "tiny", "--data", "a=b", "--out", str(tmp_path / "out"), "--config.model.router.kind", "auto"]
    assert main([*words, *others]) == 2
    assert "add --config.no-route-by-label and --config.domain-weight 0" in capsys.readouterr().err
    assert main([*words, "--config.no-route-by-label", "--config.domain-weight", "0"]) == 2
    assert "--config.domain-weight" not in capsys.readouterr().err  # but for the data, which are not there


@pytest.mark.parametrize("missing", ["--data", "--out"])
def test_data_and_out_must_be_given(
    tiny_recipe: Callable[[str], None], missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_recipe("metric")
    given = {"--data": ["--data", "a=b"], "--out": ["--out", "out"]}
    del given[missing]
    with pytest.raises(SystemExit) as stopped:
        main(["train", "tiny", *(word for words in given.values() for word in words)])
    assert stopped.value.code == 2
    assert missing in capsys.readouterr().err


def test_paths_of_lists_are_relative_to_root(
    tiny_recipe: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_recipe("metric")
    indoor = write_pairs(tmp_path / "indoor", n=1).rename(tmp_path / "list.csv")
    arguments = ["train", "tiny", "--data", f"indoor={indoor}", "--out", str(tmp_path / "out"), "--config.steps", "1"]
    assert main(arguments) == 2
    assert f"{tmp_path / 'image/train_000.jpg'}" in capsys.readouterr().err
    assert main([*arguments, "--root", str(tmp_path / "indoor")]) == 0


class TestFinetune:
    """``zoedepth train finetune``: its options. ``tests/train/test_finetune.py`` tests what it does."""

    def test_all_options_arrive(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        asked = []

        def plan(data: dict[str, str], options: FinetuneOptions, **_: object) -> NoReturn:
            asked.append((data, options))
            raise InputError("that is all")

        monkeypatch.setattr("zoedepth.train.finetune.plan", plan)
        arguments = ["train", "finetune", "-o", str(tmp_path / "out"), "--data", "a/list.csv", "more=b"]
        assert main(arguments) == 2
        options = [
            "--init", "zoed-m12-n", "--domain", "attic", "--depth-scale", "500", "--root", "c", "--check", "full",
            "--holdout", "3", "--steps", "7", "--batch-size", "5", "--learning-rate", "0.5", "--seed", "9",
        ]  # fmt: skip
        assert main([*arguments, *options]) == 2
        data = {"a": "a/list.csv", "more": "b"}
        changed = FinetuneOptions("zoed-m12-n", "attic", 500.0, "full", 3, 7, 5, 0.5, 9, root="c")
        assert asked == [(data, FinetuneOptions()), (data, changed)]

    @pytest.mark.parametrize(("options", "expected"), [([], (None, 1)), (["--devices", "2", "--nodes", "3"], (2, 3))])
    def test_processes_and_machines_arrive(
        self, tiny_recipe: Callable[[str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str],
        expected: tuple[int | None, int], capsys: pytest.CaptureFixture[str],
    ) -> None:  # fmt: skip
        tiny_recipe("metric")
        planned, asked = Plan(RECIPES["tiny"](), {}, {}, {}, "zoed-lite", (), ()), []

        def finetune(plan: Plan, *, out: Path, devices: int | None, n_nodes: int) -> dict[str, object]:
            asked.append((plan, out, devices, n_nodes))
            return {}

        monkeypatch.setattr("zoedepth.train.finetune.plan", lambda *_, **__: planned)
        monkeypatch.setattr("zoedepth.train.finetune.finetune", finetune)
        out = tmp_path / "out"
        assert main(["train", "finetune", "--data", "a", "--out", str(out), *options]) == 0
        assert asked == [(planned, out, *expected)]
        assert str(out) in capsys.readouterr().out
        monkeypatch.setattr("zoedepth.train.processes.is_first", lambda: False)
        assert main(["train", "finetune", "--data", "a", "--out", str(out), *options]) == 0
        assert capsys.readouterr().out == ""

    def test_help_shows_first_what_is_needed_most(self, capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SystemExit):
            main(["train", "finetune", "--help"])
        first, _, more = capsys.readouterr().out.partition("more options")
        assert all(option in first for option in ("--data", "--out", "--init", "--domain", "--depth-scale", "--root"))
        assert all(option in more for option in ("--check", "--learning-rate", "--seed", "--devices"))
        assert "None" not in first + more

    @pytest.mark.parametrize("module", ["lightning_fabric", "tensorboard"])
    def test_what_is_not_installed_is_said_before_the_data_is_looked_at(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], module: str
    ) -> None:
        monkeypatch.setitem(sys.modules, module, None)
        assert main(["train", "finetune", "--data", "nowhere.csv", "--out", str(tmp_path / "out")]) == 2
        assert "pip install 'zoedepth[train]'" in capsys.readouterr().err
