"""The log of a run: console, JSONL and TensorBoard. Nothing else in this package prints while it trains."""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from zoedepth.errors import InputError
from zoedepth.images import ImageArray, atomic_path, write_image
from zoedepth.train.config import TrainConfig

console = Console(stderr=True)


def say(text: str) -> None:
    """Show a line on the console."""
    console.print(text, highlight=False, markup=False, soft_wrap=True)


def check_log(folder: Path) -> None:
    """Check that a ``log.jsonl`` in a folder is that of a run: the log of a new run replaces it.

    Raises:
        InputError: it is something else.
    """
    path = folder / "log.jsonl"
    if path.is_file():
        with path.open("rb") as file:
            first = file.readline(1 << 16).decode("utf-8", "replace")
        if first.strip() and not first.startswith('{"step": '):
            raise InputError(f"{path} is not the log of a run, and would be replaced: choose another --out")


class Ticker:
    """A line every 15 seconds that says how far something is. Called with the number that is done, and of all.

    Args:
        what: the work, as the line begins.
        say: shows a line.
    """

    EVERY = 15.0

    def __init__(self, what: str, say: Callable[[str], object]) -> None:
        self._what, self._say = what, say
        self._last = monotonic()

    def __call__(self, done: int, total: int) -> None:
        """Show a line if it is time."""
        if monotonic() - self._last >= self.EVERY:
            self._last = monotonic()
            self._say(f"{self._what}: {done:,} of {total:,}")


class Log:
    """The log of a run. Use it as a context, or close it.

    Args:
        folder: the run's folder, for ``log.jsonl``, ``tensorboard/`` and ``pictures/``.
        config: the configuration of the run.
        first_step: number of steps already taken; what an interrupted run has logged of later ones is dropped.
        active: False for all processes but the first: they write nothing.
    """

    def __init__(self, folder: Path, config: TrainConfig, *, first_step: int, active: bool) -> None:
        self.active = active
        self._since = monotonic()
        self._step = first_step
        self._batch_size = config.batch_size
        if not active:
            return
        from torch.utils.tensorboard import SummaryWriter

        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._jsonl = folder / "log.jsonl"
        self._forget_after(first_step)
        self._tensorboard = SummaryWriter(str(folder / "tensorboard"), purge_step=first_step + 1)
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
            TextColumn("{task.fields[state]}"), console=console,
        )  # fmt: skip
        self._task = self._progress.add_task(config.stage, total=config.steps, completed=first_step, state="")
        self._progress.start()

    def __enter__(self) -> "Log":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def say(self, text: str) -> None:
        """Show a line on the console."""
        if self.active:
            self._progress.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def write(self, step: int, values: Mapping[str, float], *, waited: float | None = None) -> None:
        """Log numbers of a step.

        Args:
            step: number of steps taken.
            values: name ("train/silog", "rate/head") → value.
            waited: seconds spent waiting for data since the last call that gave this argument; the speed of training is
                logged with it. None: these numbers come from a validation.
        """
        if not self.active:
            return
        numbers = {name: round(value, 10) for name, value in values.items()}
        if waited is not None:
            seconds = max(monotonic() - self._since, 1e-9)
            numbers["images_per_s"] = round((step - self._step) * self._batch_size / seconds, 2)
            numbers["data_wait"] = round(waited / seconds, 4)
            self._since, self._step = monotonic(), step
        with self._jsonl.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"step": step, **numbers}) + "\n")
        for name, value in numbers.items():
            self._tensorboard.add_scalar(name if "/" in name else f"speed/{name}", value, step)
        shown = {name.removeprefix("train/"): value for name, value in numbers.items() if not name.startswith("rate/")}
        text = " ".join(f"{name}={value:.4g}" for name, value in shown.items())
        self._progress.update(self._task, completed=step, state=text)
        if not console.is_terminal or waited is None:
            self._progress.console.print(f"step {step}: {text}", highlight=False)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Leave the time spent in this context out of the speed of training."""
        began = monotonic()
        yield
        self._since += monotonic() - began

    def picture(self, step: int, image: ImageArray) -> None:
        """Write a picture to TensorBoard and to ``pictures/step_000123.jpg``."""
        if self.active:
            write_image(self._folder / "pictures" / f"step_{step:06d}.jpg", image)
            self._tensorboard.add_image("predictions", image, step, dataformats="HWC")

    def close(self) -> None:
        """Finish the progress bar and the files."""
        if self.active:
            self._progress.stop()
            self._tensorboard.close()

    def _forget_after(self, step: int) -> None:
        """Drop the lines of later steps: a run resumed from an earlier checkpoint repeats them."""
        if self._jsonl.is_file():
            lines = self._jsonl.read_text(encoding="utf-8").splitlines()
            with atomic_path(self._jsonl) as part:
                part.write_text("".join(f"{line}\n" for line in lines if _logged_step(line) <= step), encoding="utf-8")


def _logged_step(line: str) -> float:
    """Return the step of a line of the log; infinity for a line that a kill has cut off."""
    try:
        return json.loads(line)["step"]
    except ValueError:
        return math.inf
