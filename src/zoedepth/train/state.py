"""The state of a run: everything that an interrupted run needs to go on as if it had not been interrupted."""

import dataclasses
import json
import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from zoedepth.config import from_dict, to_dict
from zoedepth.errors import InputError
from zoedepth.model.interface import DepthModel
from zoedepth.train.config import TrainConfig
from zoedepth.train.identity import same_start
from zoedepth.train.processes import resolve
from zoedepth.weights.save import save_model

if TYPE_CHECKING:
    from lightning_fabric.plugins import Precision

_HARMLESS = frozenset({
    "n_workers", "log_every", "validate_every", "checkpoint_every", "keep_checkpoints", "pictures", "check",
})  # fmt: skip
"""Fields of the configuration that change nothing in the result."""

_REASONS = {
    "data_state": "Files of the data, or what is said of them, have changed since (size or time; rsync -a keeps both)",
    "steps": "Only a finished run can be lengthened, and none be shortened",
    "init": "It began with other starting weights (--init)",
}


@dataclass
class TrainState:
    """The state of a run: everything in it that changes while training."""

    model: DepthModel
    optimizer: torch.optim.Optimizer
    ema: AveragedModel | None
    precision: "Precision | None" = None
    """Fabric's precision: that of float16 has a state, the factor of the loss."""
    step: int = 0
    """Number of optimizer steps taken."""
    task_weights: Tensor | None = None
    """Stage 1: the last solution for the weights of the data sets."""
    begun: tuple[tuple[Tensor, Tensor | None], Tensor | None, list[tuple[Tensor, Tensor]]] | None = None
    """Random numbers of processor and GPU, ``task_weights``, and (buffer, copy) of batch norms that learn, when the
    step at hand began; None between two steps."""
    whole: bool = True
    """False while an optimizer step changes the weights one after another."""

    def begin(self) -> None:
        """Remember what the step that begins now may change before the optimizer does."""
        norms = [module for module in self.model.modules() if isinstance(module, nn.modules.batchnorm._BatchNorm)]
        buffers = [buffer for norm in norms if norm.training for buffer in norm.buffers()]
        self.begun = (self._random_numbers(), self.task_weights, [(buffer, buffer.clone()) for buffer in buffers])

    @contextmanager
    def changing(self) -> Iterator[None]:
        """Mark the state as not whole while the block changes it. An error in the block leaves it so."""
        self.whole = False
        yield
        self.whole, self.begun = True, None

    def go_back(self) -> bool:
        """Take back what the step at hand has changed before the optimizer; return False if it is too late for that."""
        if self.whole and self.begun is not None:
            random_numbers, self.task_weights, buffers = self.begun
            self._set_random_numbers(*random_numbers)
            for buffer, copy in buffers:
                buffer.copy_(copy)
        return self.whole

    @property
    def result(self) -> DepthModel:
        """The model to validate and to ship: the moving average if there is one."""
        if self.ema is None:
            return self.model
        averaged: Any = self.ema.module  # a copy of the model
        return averaged

    def save(self, folder: Path, config: TrainConfig, identity: Mapping[str, Any] = MappingProxyType({})) -> Path:
        """Write ``folder/step_000123/{model.safetensors, train.pt, meta.json}``, whole or not at all.

        ``load_model`` takes ``model.safetensors`` like any other model; ``train.pt`` is for resuming. Older checkpoints
        than the newest ``config.keep_checkpoints`` are removed.

        Args:
            folder: the run's folder.
            config: the run's configuration.
            identity: plain values that tell this run from another of the same configuration: its data.

        Returns:
            The folder of the checkpoint.
        """
        final = folder / f"step_{self.step:06d}"
        part = folder / f".{final.name}.part"
        shutil.rmtree(part, ignore_errors=True)
        try:
            self._write(part, config, identity)
        except BaseException:  # a full disk: make room
            shutil.rmtree(part, ignore_errors=True)
            raise
        shutil.rmtree(final, ignore_errors=True)
        os.replace(part, final)
        for old in checkpoints(folder)[: -config.keep_checkpoints]:
            shutil.rmtree(old)
        return final

    def _random_numbers(self) -> tuple[Tensor, Tensor | None]:
        """Return the state of the generators of random numbers, on the processor and on the GPU if there is one."""
        return torch.get_rng_state(), torch.cuda.get_rng_state() if _device(self.model).type == "cuda" else None

    def _set_random_numbers(self, processor: Tensor, gpu: Tensor | None) -> None:
        torch.set_rng_state(processor)
        if gpu is not None and _device(self.model).type == "cuda":
            torch.cuda.set_rng_state(gpu)

    def _write(self, part: Path, config: TrainConfig, identity: Mapping[str, Any]) -> None:
        part.mkdir(parents=True)
        processor, gpu = self._random_numbers()
        save_model(self.result, part / "model.safetensors")
        torch.save(
            {
                "model": self.model.state_dict(),
                "optimizer": self.optimizer.state_dict(),
                "ema": self.ema.state_dict() if self.ema is not None else None,
                "rng": processor,
                "device_rng": gpu,
                "task_weights": self.task_weights,
                "precision": {} if self.precision is None else self.precision.state_dict(),
            },
            part / "train.pt",
        )
        meta = {"step": self.step, "config": to_dict(config), "precision": resolve(config.precision), **identity}
        (part / "meta.json").write_text(json.dumps(meta, indent=2), encoding="utf-8")
        for path in part.iterdir():  # on the disk before the rename: after a power cut the older checkpoint is whole
            with path.open("rb") as file:
                os.fsync(file.fileno())

    def load(self, checkpoint: Path, config: TrainConfig, identity: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Load a checkpoint of the same configuration and data; workers, logging and the like may differ.

        Args:
            checkpoint: the folder of the checkpoint.
            config: the run's configuration.
            identity: see ``save``.

        Raises:
            InputError: the checkpoint is damaged, or its configuration or data differ; the message names the fields.
        """
        check_same(checkpoint, config, identity)
        try:
            meta = json.loads((checkpoint / "meta.json").read_text(encoding="utf-8"))
            values: dict[str, Any] = torch.load(checkpoint / "train.pt", map_location="cpu", weights_only=True)
        except Exception as error:  # a damaged file can raise anything
            raise damaged(checkpoint, error) from error
        try:
            self.model.load_state_dict(values["model"])
            self.optimizer.load_state_dict(values["optimizer"])
            if self.ema is not None:
                self.ema.load_state_dict(values["ema"])
            self._set_random_numbers(values["rng"], values.get("device_rng"))
            weights = values.get("task_weights")
            self.task_weights = None if weights is None else weights.to(_device(self.model))
            # Checkpoints of earlier versions have no state of the precision.
            if self.precision is not None and (precision := values.get("precision")):
                self.precision.load_state_dict(precision)
            self.step = int(meta["step"])
        except (RuntimeError, KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"cannot resume from {checkpoint}, its state does not fit the model: {error}. Remove it to go on from "
                "an older checkpoint"
            ) from error


def _device(model: nn.Module) -> torch.device:
    return next(model.parameters()).device


def check_same(
    checkpoint: Path, config: TrainConfig, identity: Mapping[str, Any], *, besides: Collection[str] = ()
) -> None:
    """Check that a checkpoint belongs to this configuration, this data and these starting weights.

    A finished run may be lengthened: it goes on with more steps.

    Args:
        checkpoint: the folder of the checkpoint.
        config: the run's configuration.
        identity: see ``TrainState.save``.
        besides: fields of the configuration that may differ.

    Raises:
        InputError: it belongs to others, or is damaged; the message names what differs.
    """
    try:
        meta = json.loads((checkpoint / "meta.json").read_text(encoding="utf-8"))
        saved = from_dict(TrainConfig, meta["config"], where="config")
        step = int(meta["step"])
    except Exception as error:  # a damaged file can raise anything
        raise damaged(checkpoint, error) from error
    harmless = {*_HARMLESS, *besides}
    if step >= saved.steps and config.steps > saved.steps:
        harmless.add("steps")
    differing = [
        field.name
        for field in dataclasses.fields(TrainConfig)
        if field.name not in harmless and getattr(saved, field.name) != getattr(config, field.name)
    ]
    differing += [name for name, value in identity.items() if not same_start(meta.get(name, value), value)]
    if differing:
        kept = "the result of a finished run" if step >= saved.steps else f"a run of {step} of {saved.steps} steps"
        why = "".join(f". {_REASONS[name]}" for name in differing if name in _REASONS)
        raise InputError(
            f"{checkpoint.parent} has {kept}, whose values of {differing} differ from this one's{why}. Use the same "
            "values, or another --out"
        )


def precision_of(checkpoint: Path) -> str | None:
    """Return the precision that a checkpoint was computed in, where its configuration leaves it to the machine.

    None where an earlier version wrote it.
    """
    return json.loads((checkpoint / "meta.json").read_text(encoding="utf-8")).get("precision")


def damaged(checkpoint: Path, error: Exception) -> InputError:
    """Return the error of a checkpoint that cannot be gone on from."""
    return InputError(
        f"cannot resume from {checkpoint}, it is damaged: {error}. Remove it to go on from an older checkpoint"
    )


def checkpoints(folder: Path) -> list[Path]:
    """Return the finished checkpoints in a run's folder, oldest first."""
    finished = {
        int(number): path
        for path in folder.glob("step_*")
        # A copy of one under another name, such as step_000100_best, is nobody's checkpoint here.
        if (number := path.name.removeprefix("step_")).isdecimal() and (path / "meta.json").is_file()
    }
    return [path for _, path in sorted(finished.items())]


def averaged(model: nn.Module, decay: float | None) -> AveragedModel | None:
    """Return a copy of the model for its exponential moving average, buffers included; None without a decay."""
    if decay is None:
        return None
    return AveragedModel(model, multi_avg_fn=get_ema_multi_avg_fn(decay), use_buffers=True)
