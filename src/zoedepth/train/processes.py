"""The processes of a training: one, several on this machine, or those that torchrun started on many machines."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal

import torch
import torch.distributed as distributed
from torch import Tensor

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.train.config import Precision, TrainConfig

if TYPE_CHECKING:
    from lightning_fabric import Fabric


def require_libraries() -> None:
    """Check that the libraries of a training are installed, without importing them: before anything takes time.

    Raises:
        MissingExtraError: one of them is not.
    """
    for module in ("lightning_fabric", "tensorboard"):
        if find_spec(module) is None:
            raise MissingExtraError("train", "zoedepth train")


def launch_fabric(config: TrainConfig, *, devices: int | None, n_nodes: int) -> "Fabric":
    """Start the processes, and return Fabric on this machine's accelerator or CPU. Several processes train by DDP.

    Args:
        config: the configuration of the training; its precision is used.
        devices: processes on each machine; None: as many as torchrun has started here, or one.
        n_nodes: number of machines; under torchrun its number is used instead.

    Raises:
        InputError: torchrun has started another number of processes than ``devices``.
        MissingExtraError: Lightning Fabric or TensorBoard is not installed.
    """
    require_libraries()
    from lightning_fabric import Fabric
    from lightning_fabric.strategies import DDPStrategy

    started, here = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    if "TORCHELASTIC_RUN_ID" in os.environ:
        if devices not in (None, here):
            raise InputError(
                f"torchrun has started {here} processes here, but --devices says {devices}: leave --devices out"
            )
        devices, n_nodes = here, started // here
    devices = devices or 1
    # A batch may not need all heads; the parameters of the others then get no gradient.
    several = devices * n_nodes > 1
    strategy = DDPStrategy(find_unused_parameters=True) if several else "auto"
    fabric = Fabric(
        accelerator="auto", devices=devices, num_nodes=n_nodes, precision=resolve(config.precision), strategy=strategy
    )
    fabric.launch()
    return fabric


def resolve(precision: Precision) -> Literal["bf16-mixed", "16-mixed", "32-true"]:
    """Return the precision that "auto" stands for on this machine; any other value as it is.

    A CPU without bfloat16 takes ten times as long for a convolution in it as in float32 (AVX2: docs/log.md).
    """
    if precision != "auto":
        return precision
    if torch.cuda.is_available():
        # GPUs before Ampere, such as the T4, emulate it, slower than float32.
        return "bf16-mixed" if torch.cuda.is_bf16_supported(including_emulation=False) else "16-mixed"
    if torch.backends.mps.is_available():
        return "32-true"
    return "bf16-mixed" if torch.ops.mkldnn._is_mkldnn_bf16_supported() else "32-true"


def total(x: Tensor) -> Tensor:
    """Return the sum of a tensor over all processes, the same on each; gradients flow back.

    DDP averages the gradients of the processes. A loss made of such sums is the same on every process, and the average
    of its gradients is the gradient that one process with the whole batch would get.
    """
    function: Any = _Total  # torch does not say what its apply returns
    return function.apply(x) if several_processes() else x


def own_device() -> str:
    """Return the device of this process: under torchrun each has a GPU of its own."""
    return f"cuda:{os.environ.get('LOCAL_RANK', 0)}" if torch.cuda.is_available() else "auto"


def is_first() -> bool:
    """Return True in the first of the processes of a training, and where there is only one."""
    return not several_processes() or distributed.get_rank() == 0


def anywhere(noted: bool, device: torch.device) -> bool:
    """Return True if any of the processes has noted something: then all of them have to act on it, after this step."""
    if not several_processes():
        return noted
    return bool(total(torch.tensor(float(noted), device=device)) > 0)


@contextmanager
def raw_gradients() -> Iterator[None]:
    """Allow ``torch.autograd.grad`` inside this context on a network that Fabric has set up for mixed precision.

    Fabric refuses every backward pass that is not ``fabric.backward``, so that nobody forgets float16's scaling of the
    loss. It has no public way to ask for unscaled gradients of a part of the network.
    """
    from lightning_fabric import wrappers

    before = wrappers._in_fabric_backward
    wrappers._in_fabric_backward = True
    try:
        yield
    finally:
        wrappers._in_fabric_backward = before


def several_processes() -> bool:
    """Return True if this process is one of several."""
    return distributed.is_available() and distributed.is_initialized() and distributed.get_world_size() > 1


class _Total(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        x = x.clone()
        distributed.all_reduce(x)
        return x

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        # The losses of all processes are the same one, and each contains this term.
        return gradients[0] * distributed.get_world_size()
