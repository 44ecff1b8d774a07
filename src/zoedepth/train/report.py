"""Report a step: log, validate, draw, write a checkpoint, and end if somebody asked for it."""

from collections.abc import Mapping
from itertools import islice

from zoedepth.data.sample import Batch, Sample
from zoedepth.errors import InputError
from zoedepth.train.log import say
from zoedepth.train.pictures import predictions_sheet
from zoedepth.train.processes import anywhere
from zoedepth.train.run import Run
from zoedepth.train.tolerant import readable
from zoedepth.train.validate import validate


def report(run: Run, numbers: Mapping[str, float], batch: Batch) -> None:
    """Log, validate, draw and write a checkpoint, each when its step has come.

    Args:
        run: the run; its step has been taken.
        numbers: name → value of the parts of the loss and the like, logged as ``train/{name}``.
        batch: the last batch of the step, for the pictures where nothing is held out.

    Raises:
        KeyboardInterrupt: the run was asked to end, after its last step, too, since its caller may have more to do; the
            checkpoint of this step is written.
        InputError: too many samples turned out to be broken.
    """
    _tell_broken(run)
    config, step = run.config, run.state.step
    last = step == config.steps
    interrupted = run.interruption.asked(run.fabric)
    if run.fabric.is_global_zero:
        # As many lines in a row as data sets have turns: else all lines would be of the same data set.
        if (step >= config.log_every and step % config.log_every < run.turns) or last:
            rates = {f"rate/{group['name']}": group["lr"] for group in run.optimizer.param_groups}
            train = {f"train/{name}": float(value) for name, value in numbers.items()}
            run.log.write(step, {**train, **rates}, waited=run.batches.take_waited())
        with run.log.paused():
            if step % config.validate_every == 0 or last:
                _validate_and_draw(run, batch)
            if step % config.checkpoint_every == 0 or last or interrupted:
                run.state.save(run.out, config, run.identity)
    if interrupted:
        run.fabric.barrier()
        raise run.interruption.error(f"step {step} is saved; the same command goes on from there")


def _tell_broken(run: Run) -> None:
    """Name the samples that were skipped since the last step, by whichever process, and end if there are too many."""
    for samples in run.tolerant:
        for problem in samples.newly_broken():
            say(f"skipped: {problem}") if not run.log.active else run.log.say(f"skipped: {problem}")
    too_many = [samples for samples in run.tolerant if samples.too_many]
    if anywhere(bool(too_many), run.fabric.device):
        raise InputError(too_many[0].explain() if too_many else "another process cannot read its samples: see above")


def _validate_and_draw(run: Run, batch: Batch) -> None:
    """Measure the model on the held-out samples, and draw its predictions."""
    model, stage, step = run.state.result, run.config.stage, run.state.step
    if run.validation:
        run.log.write(step, validate(model, run.validation, stage=stage))
    if run.config.pictures:
        run.log.picture(step, predictions_sheet(model, _shown(run, batch), stage=stage))


def _shown(run: Run, batch: Batch) -> list[Sample]:
    """Return the samples to draw: held-out ones of every data set, or else those of the batch."""
    n = run.config.pictures
    held_out = [sample for subset in run.validation.values() for sample in islice(readable(subset), n)]
    if held_out:
        return held_out[:: max(1, len(held_out) // n)][:n]
    return batch.samples([domain.name for domain in run.config.model.domains])[:n]
