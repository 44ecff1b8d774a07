"""One optimizer step, in the parts that both stages share: begin, backward, step."""

import math
from collections.abc import Mapping, Sequence
from typing import cast

from torch import Tensor, nn

from zoedepth.data.sample import Batch
from zoedepth.errors import TrainingError
from zoedepth.train.optim import set_rates
from zoedepth.train.processes import resolve
from zoedepth.train.run import Run


def begin_step(run: Run) -> None:
    """Set the rates of this step, and put the model into training mode."""
    set_rates(run.optimizer.optimizer, run.state.step, run.config.steps, run.config.optim)
    run.state.model.train()
    if run.config.freeze_batch_norm:
        freeze_batch_norm(run.state.model.encoder)
    run.state.begin()


def backward(run: Run, loss: Tensor, batch: Batch, *, complete: bool) -> None:
    """Add the gradients of a batch's loss to those of the step.

    Args:
        run: the run.
        loss: the loss of the batch of all processes, see ``zoedepth.train.processes.total``.
        batch: the batch that the loss was computed from; an error names its images.
        complete: True for the last batch of the step: then processes exchange their gradients.

    Raises:
        TrainingError: the loss is not finite; the weights are as they were.
    """
    if not math.isfinite(loss.item()):
        raise _not_finite("loss", loss.item(), run, [batch])
    with run.fabric.no_backward_sync(run.network, enabled=not complete):
        run.fabric.backward(loss / run.config.accumulate)


def take_step(run: Run, batches: Sequence[Batch]) -> float:
    """Clip the gradients, change the weights and their moving average, and count the step.

    Args:
        run: the run.
        batches: the batches of the step; an error names their images.

    Returns:
        The norm of the gradients before they were clipped.

    Raises:
        TrainingError: the gradients are not finite; the weights are as they were.
    """
    clipped = run.fabric.clip_gradients(
        run.network, run.optimizer, max_norm=run.config.optim.clip, error_if_nonfinite=False
    )
    norm = cast(Tensor, clipped).item()
    # In float16 the scaling of the loss meets infinite gradients now and then, and skips the step by itself.
    if resolve(run.config.precision) != "16-mixed" and not math.isfinite(norm):
        raise _not_finite("norm of the gradients", norm, run, batches)
    with run.state.changing():
        run.optimizer.step()
        run.optimizer.zero_grad()
        if run.state.ema is not None:
            run.state.ema.update_parameters(run.state.model)
        run.state.step += 1
    return norm


def means(terms: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means over the batches of a step, of each number over the batches that have it.

    A batch has no number of a data set of which it has no image.
    """
    found: dict[str, list[float]] = {}
    for name, value in (item for batch in terms for item in batch.items()):
        found.setdefault(name, []).append(value)
    return {name: sum(values) / len(values) for name, values in found.items()}


def freeze_batch_norm(model: nn.Module) -> None:
    """Put all batch norms into evaluation mode: their statistics stay, their weights still learn."""
    for module in model.modules():
        if isinstance(module, nn.modules.batchnorm._BatchNorm):
            module.eval()


def _not_finite(name: str, value: float, run: Run, batches: Sequence[Batch]) -> TrainingError:
    images = [image for batch in batches for image in batch.names]
    return TrainingError(
        f"the {name} is {value} at step {run.state.step + 1}; the images were {images}. Check their depth, or "
        "lower optim.learning_rate. The last checkpoint is intact"
    )
