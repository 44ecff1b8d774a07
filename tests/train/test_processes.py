"""Two processes train as one: the same curve of the loss at the same global batch."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from tests.folders import write_disparity_pairs, write_pairs
from tests.processes import beside
from tests.train.runs import log_of

from zoedepth.cli import main
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.train import processes
from zoedepth.train.config import TrainConfig
from zoedepth.train.processes import launch_fabric, own_device, resolve, several_processes, total

STEPS = 4
COMMON = [
    "--config.steps", str(STEPS), "--config.batch-size", "4", "--config.model.size", "64", "64", "--config.precision",
    "32-true", "--config.n-workers", "0", "--config.log-every", "1", "--config.pictures", "0",
    "--config.checkpoint-every", str(STEPS),
]  # fmt: skip
METRIC = ["zoed_lite", "--config.optim.learning-rate", "3e-5"]
# Medians, signs and trimming jump: with larger steps the last digit of a sum decides on the loss some steps later.
RELATIVE = [
    "zoed_lite_relative", "--config.optim.learning-rate", "1e-6", "--init", "zoed-lite", "--config.task-weights",
    "pareto", "--config.pareto-every", "2",
]  # fmt: skip


def test_two_processes_give_the_curve_of_one(tmp_path: Path) -> None:
    write_pairs(tmp_path / "indoor", n=6, focal_px=(60.0,) * 6)
    write_pairs(tmp_path / "outdoor", n=4, domain="outdoor", focal_px=(60.0,) * 4)
    write_disparity_pairs(tmp_path / "relative", n=3)

    def both_stages(out: str) -> Iterator[list[str]]:
        for recipe, names in ((METRIC, ["indoor", "outdoor"]), (RELATIVE, ["indoor", "outdoor", "relative"])):
            data = [f"{name}={tmp_path / name / 'train.csv'}" for name in names]
            yield ["train", *recipe, *COMMON, "--data", *data, "--out", str(tmp_path / out / recipe[0])]

    assert [main(command) for command in both_stages("one")] == [0, 0]
    with beside(*both_stages("two")) as second:
        assert [main(command) for command in both_stages("two")] == [0, 0]
    assert second.codes == [0, 0]
    shown = {
        "zoed_lite": ["train/silog", "train/domain"],
        "zoed_lite_relative": ["train/ssi", "train/weight/indoor", "train/weight/outdoor", "train/weight/relative"],
    }
    for recipe, names in shown.items():
        one, two = (log_of(tmp_path / out / recipe) for out in ("one", "two"))
        assert [line["step"] for line in two] == list(range(1, STEPS + 1))
        for name in names:
            values = [[line[name] for line in lines if name in line] for lines in (one, two)]
            # Sums over halves of a batch differ in float32's last digits, which every step of training enlarges.
            assert values[1] == pytest.approx(values[0], rel=1e-4, abs=1e-4), name
            assert max(values[0]) - min(values[0]) > 0.01, "a curve, nothing that stands still"


def test_devices_that_contradict_torchrun_are_an_error(make_config, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"TORCHELASTIC_RUN_ID": "none", "WORLD_SIZE": "4", "LOCAL_WORLD_SIZE": "2"}.items():
        monkeypatch.setenv(name, value)
    config: TrainConfig = make_config()
    with pytest.raises(InputError, match="torchrun has started 2 processes here, but --devices says 3"):
        launch_fabric(config, devices=3, n_nodes=1)


@pytest.mark.parametrize(
    ("environment", "devices", "n_nodes", "expected"),
    [
        ({}, None, 1, (1, 1, "auto")),
        ({}, 2, 3, (2, 3, "DDPStrategy")),
        ({"TORCHELASTIC_RUN_ID": "x", "WORLD_SIZE": "8", "LOCAL_WORLD_SIZE": "2"}, None, 1, (2, 4, "DDPStrategy")),
        ({"TORCHELASTIC_RUN_ID": "x", "WORLD_SIZE": "1", "LOCAL_WORLD_SIZE": "1"}, 1, 1, (1, 1, "auto")),
    ],
)
def test_processes_are_those_that_were_asked_for_or_torchruns(
    make_config, monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], devices: int | None, n_nodes: int,
    expected: tuple[int, int, str],
) -> None:  # fmt: skip
    import lightning_fabric

    for name in ("TORCHELASTIC_RUN_ID", "WORLD_SIZE", "LOCAL_WORLD_SIZE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    made = []

    class Recorded:
        def __init__(self, *, devices: int, num_nodes: int, strategy: object, precision: str, accelerator: str) -> None:
            made.append((devices, num_nodes, strategy if isinstance(strategy, str) else type(strategy).__name__))
            made.append(precision)

        def launch(self) -> None:
            made.append("launched")

    monkeypatch.setattr(lightning_fabric, "Fabric", Recorded)
    launch_fabric(make_config(precision="16-mixed"), devices=devices, n_nodes=n_nodes)
    assert made == [expected, "16-mixed", "launched"]


@pytest.mark.parametrize("module", ["lightning_fabric", "tensorboard"])
def test_without_a_library_the_extra_is_named(make_config, monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=r"zoedepth\[train\]"):
        launch_fabric(make_config(), devices=1, n_nodes=1)


@pytest.mark.parametrize(
    ("cuda", "bf16", "mps", "cpu_bf16", "expected"),
    [
        (True, True, False, False, "bf16-mixed"),
        (True, False, False, True, "16-mixed"),
        (False, False, True, True, "32-true"),
        (False, False, False, True, "bf16-mixed"),
        (False, False, False, False, "32-true"),
    ],
)
def test_precision_is_that_of_the_hardware_unless_given(
    monkeypatch: pytest.MonkeyPatch, cuda: bool, bf16: bool, mps: bool, cpu_bf16: bool, expected: str
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: cuda)
    # A GPU that emulates bfloat16 says yes where it is asked in the usual way.
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda including_emulation=True: including_emulation or bf16)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: mps)
    monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", lambda: cpu_bf16, raising=False)
    assert resolve("auto") == expected
    assert resolve("16-mixed") == "16-mixed"
    assert resolve("32-true") == "32-true"


def test_each_process_measures_on_a_gpu_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert own_device() == "cuda:0"
    monkeypatch.setenv("LOCAL_RANK", "3")
    assert own_device() == "cuda:3"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert own_device() == "auto"


def test_total_of_one_process_is_the_tensor_itself() -> None:
    x = torch.ones(2, requires_grad=True)
    assert not several_processes()
    assert total(x) is x


def test_total_sums_over_processes_and_its_gradient_is_that_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process with the same values is played by doubling."""
    monkeypatch.setattr(processes, "several_processes", lambda: True)
    monkeypatch.setattr(processes.distributed, "all_reduce", lambda x: x.mul_(2))
    monkeypatch.setattr(processes.distributed, "get_world_size", lambda: 2)
    x = torch.tensor([1.0, 3.0], requires_grad=True)
    summed = total(x)
    assert summed.tolist() == [2, 6]
    assert x.tolist() == [1, 3], "the tensor itself is left as it is"
    (summed * torch.tensor([1.0, 10.0])).sum().backward()
    assert x.grad.tolist() == [2, 20]
