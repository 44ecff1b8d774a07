"""``zoedepth benchmark [MODEL]``: every runtime of this machine, and the fastest one for ``predict --fast``."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from zoedepth.commands.options import words_of
from zoedepth.errors import InputError
from zoedepth.folders import check_writable
from zoedepth.images import atomic_path
from zoedepth.stored import read_json, to_json

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from zoedepth.runtimes.benchmark import Benchmark
    from zoedepth.runtimes.choice import Row

EXIT_FAILED = 1

_KEY = "zoedepth_benchmark"
"""First name in the file of --json, by which it is known."""

_HEADINGS = ("runtime", "s a photo", "least - most", "photos a s", "peak MB", "first depth s", "REL")


def benchmark(
    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")] = "zoed-lite",
    *,
    photos: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None,
    repeats: int = 7,
    flip: bool = True,
    int8: bool = True,
    device: Literal["auto", "cpu"] = "auto",
    workers: int | None = None,
    compat: tuple[str, ...] = (),
    json_: Annotated[Path | None, tyro.conf.arg(name="json", metavar="FILE")] = None,
) -> int:
    """Measure a model in every runtime that is installed here, and write down the fastest, for `predict --fast`.

    Rows of the table are torch, ONNX Runtime and OpenVINO, in float32, bfloat16 and 8 bits, and torch on a GPU. Each
    has a process of its own, and they take turns. The fastest is chosen whose depth is within 1 % REL of torch's in
    float32 on each of eight photos, or 0.5 % on each of fewer. It holds for these weights, on this machine, with these
    versions. Exported files and the choice are in the user's cache. Exit codes: 0 done, 1 a runtime has failed, 2 wrong
    input, 130 interrupted.

    Args:
        model: a name of `zoedepth models`, a file or folder of weights, or a Hugging Face id.
        photos: folder of photos like those that the model will see, best 16 or more; without it, three photos of the
            package. Of four and more, int8 is calibrated on other ones than it is compared on, and only then it can be
            chosen. The first one is timed.
        repeats: photos that are timed in each runtime.
        flip: average with the prediction for the mirrored photo, as `zoedepth predict` does.
        int8: measure 8 bits, too; calibrating them takes a while.
        device: cpu leaves the GPU out.
        workers: photos computed at the same time for "photos a s"; without it as many as there are cores.
        compat: see `zoedepth predict`.
        json_: file to write the table and the choice to.
    """
    from zoedepth.commands.progress import download_progress
    from zoedepth.photos import find_photos
    from zoedepth.runtimes.benchmark import benchmark as measure
    from zoedepth.runtimes.choice import write_choice

    if repeats < 1:
        raise InputError(f"--repeats must be 1 or more, got {repeats}")
    if workers is not None and workers < 1:
        raise InputError(f"--workers must be 1 or more, got {workers}")
    if json_ is not None:
        _check_replaced(json_)
        check_writable(json_.parent, option="--json")
    found: list[Path] = []
    if photos is not None:
        found = [photo.path for photo in find_photos([str(photos)], photos).photos]
        if not found:
            raise InputError(f"--photos {photos} holds no photos: give a folder with photos (.jpg, .png ...)")
    progress_console = Console(stderr=True, highlight=False)
    with download_progress() as progress, progress_console.status("Looking at the model") as status:

        def tell(text: str) -> None:
            status.update(escape(text))
            if not progress_console.is_terminal:
                progress_console.print(text, soft_wrap=True, markup=False)

        result = measure(
            model,
            photos=found,
            compat=compat,
            flip_average=flip,
            int8=int8,
            device=device,
            at_once=workers,
            repeats=repeats,
            progress=progress,
            tell=tell,
        )
    console = Console(highlight=False)
    for line in _table(result.rows, chosen=result.choice.runtime):
        console.print(line, soft_wrap=True)
    for line in _told(result, model, device=device, compat=compat):
        console.print(line, soft_wrap=True, markup=False)
    if json_ is not None:
        about = {
            _KEY: 1,
            "model": model,
            "compared_on": [str(photo) for photo in result.compared],
            "calibrated_on": [str(photo) for photo in result.calibrated],
            **result.choice.to_json(),
        }
        with atomic_path(json_) as part:
            part.write_text(to_json(about, indent=2) + "\n", encoding="utf-8")
    write_choice(result.choice)
    return EXIT_FAILED if any(row.failed for row in result.rows) else 0


def _check_replaced(path: Path) -> None:
    """Refuse to replace a file that this command has not written."""
    if path.exists():
        try:
            own = _KEY in read_json(path)
        except InputError:
            own = False
        if not own:
            raise InputError(f"--json: {path} is not a file of zoedepth benchmark, and would be replaced: give another")


def _table(rows: "Sequence[Row]", *, chosen: str) -> "Iterator[Text]":
    """Yield the lines of the table: columns of numbers, and for a row that did not run the reason in their place."""
    cells = [_cells(row) for row in rows]
    widths = [max(map(len, column)) for column in zip(_HEADINGS, *filter(None, cells), strict=True)]
    widths[0] = max(len(row.runtime) for row in rows)

    def line(name: str, numbers: "Sequence[str]", style: str = "") -> Text:
        aligned = (number.rjust(width) for number, width in zip(numbers, widths[1:], strict=False))
        return Text("  ".join((name.ljust(widths[0]), *aligned)).rstrip(), style)

    yield line(_HEADINGS[0], _HEADINGS[1:], "bold")
    for row, numbers in zip(rows, cells, strict=True):
        if numbers:
            text = line(row.runtime, numbers[1:], "bold green" if row.runtime == chosen else "")
            yield text.append(f"  {row.doubt}") if row.doubt else text
        else:
            yield Text(f"{row.runtime.ljust(widths[0])}  {row.problem}", "red" if row.failed else "dim")


def _cells(row: "Row") -> tuple[str, ...]:
    """Return what the table says of a row that ran; nothing of others."""
    if row.seconds is None or row.least is None or row.most is None:
        return ()
    memory = "?" if row.memory_mb is None else f"{row.memory_mb:.0f}"
    return (
        row.runtime,
        f"{row.seconds:.3f}",
        f"{row.least:.3f} - {row.most:.3f}",
        f"{row.photos_a_second:.2f}",
        memory if row.gpu_memory_mb is None else f"{memory} + {row.gpu_memory_mb:.0f} GPU",
        f"{row.first_depth:.1f}",
        f"{row.difference:.1e}",
    )


def _told(result: "Benchmark", model: str, *, device: str, compat: "Sequence[str]") -> "Iterator[str]":
    """Yield what there is to say below the table, and the command that takes the choice: one for the same options."""
    from zoedepth.runtimes.choice import ENOUGH_PHOTOS, MAX_REL

    choice = result.choice
    few = "" if len(result.compared) >= ENOUGH_PHOTOS else f" ({MAX_REL:.0%} with {ENOUGH_PHOTOS} photos: --photos)"
    yield (
        f"{choice.machine}. REL: the largest of {len(result.compared)} photos, against torch in float32; chosen up to "
        f"{result.max_rel:.1%}{few}."
    )
    chosen = next(row for row in result.rows if row.runtime == choice.runtime)
    yield f"Chosen: {choice.runtime}, {chosen.photos_a_second:.2f} photos a second, REL {chosen.difference:.1e}."
    options = {
        "--fast": True,
        "--model": None if model == "zoed-lite" else model,
        "--device": None if device == "auto" else device,
        "--compat": compat,
    }
    yield f"To use it: zoedepth predict PHOTOS --out FOLDER {shlex.join(words_of(options))}"
