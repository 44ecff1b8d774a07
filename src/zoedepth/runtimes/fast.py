"""Load a model for what computes it fastest on this machine.

That is what ``zoedepth benchmark`` has found, or, without a benchmark of these weights here with these versions, what
follows from the installed runtimes and one measured product, which is written down. OpenVINO comes first: of everything
in float32 in docs/performance.md it is the fastest. ONNX Runtime follows for the model in the package, which starts in
it without torch. For other models torch does: ONNX Runtime takes 1.15 times as long there. bfloat16 is taken where
products in it are faster than in float32, if the model is faster then, too, and gives the same depth.
"""

import logging
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from zoedepth.download import Progress
from zoedepth.errors import FullDiskError, InputError, ZoeDepthError
from zoedepth.forward.answer import Precision
from zoedepth.images import read_image
from zoedepth.predict import Predictor
from zoedepth.runtimes.benchmark import EXAMPLES
from zoedepth.runtimes.choice import Choice, allowed_rel, read_choice, write_choice
from zoedepth.runtimes.exports import Source, exported_file, find_source, packaged_graph
from zoedepth.runtimes.machine import Machine, this_machine, versions
from zoedepth.runtimes.products import products
from zoedepth.runtimes.runtime import BASE, RUNTIMES, Library, Runtime
from zoedepth.runtimes.worker import largest_rel
from zoedepth.threads import cpu_count, threads
from zoedepth.weights.exported import ExportedModel, is_exported
from zoedepth.weights.load import load_for_prediction

if TYPE_CHECKING:
    from zoedepth.model.interface import DepthModel

FAST_PRODUCTS = 1.3
"""Speed of products in bfloat16, in those of float32, from which bfloat16 is tried."""

_WORTH_IT = 1.1  # times that the model itself must be faster in bfloat16

_log = logging.getLogger("zoedepth")


@dataclass(frozen=True)
class Fast:
    """A model that is loaded for what computes it fastest, and why that is."""

    model: "DepthModel | ExportedModel"
    runtime: str
    """The name of the runtime: "OpenVINO, bfloat16"."""
    why: str
    """The reason in a few words."""
    precision: Precision
    """The precision for ``Predictor``."""
    device: str
    """The device for ``Predictor``."""


def load_fast(
    model: str | Path,
    *,
    compat: Iterable[str] = (),
    device: str = "auto",
    streams: int = 1,
    metres: bool = True,
    progress: Progress | None = None,
    tell: Callable[[str], object] | None = None,
) -> Fast:
    """Load a model for what computes it fastest on this machine. Its depth is within 1 % of that of torch in float32.

        fast = load_fast("zoed-lite")
        predictor = Predictor(fast.model, precision=fast.precision, device=fast.device)

    The first call for a model exports it, once, to the user's cache; where that fails it runs in torch. What OpenVINO
    compiles from it is kept there, too.

    Args:
        model: a name, file, folder or Hugging Face id, see ``load_model``. An exported file runs in its own runtime.
        compat: see ``load_model``.
        device: see ``Predictor``; "cpu" looks for no GPU.
        streams: number of forwards that will run at the same time.
        metres: False if relative depth is wanted, which only torch has.
        progress: see ``load_model``.
        tell: called with a sentence before something that takes long; None: a line in the log.

    Raises:
        InputError: there is no such model, it cannot be loaded, or ``compat`` is given for an exported file.
    """
    say = tell or _log.warning
    if is_exported(model):
        network = load_for_prediction(model, device=device, compat=compat, streams=streams)
        assert isinstance(network, ExportedModel)
        return Fast(
            network, f"{network.runtime}, {network.precision}", "the file is of this runtime", "float32", device
        )
    source = find_source(model, compat=compat, progress=progress)
    if not metres:
        return _base(source, device, "only torch has relative depth")
    machine = this_machine(device)
    on_other = device not in ("auto", "cpu")
    if on_other and machine.accelerator is None:
        return _base(source, device, "the device was asked for")
    choice = read_choice(source.weights, machine, versions())
    # Exports may be deleted at any time. All but int8, which is calibrated on photos, are made again.
    if choice is None or (RUNTIMES[choice.runtime].numbers == "int8" and not Path(choice.file).is_file()):
        choice, lasting = decide(source, machine, tell=say)
        if lasting:
            try:
                write_choice(choice)
            except OSError as error:
                _log.warning("the choice of a runtime was not written down (%s)", error)
    runtime = RUNTIMES[choice.runtime]
    if on_other and not runtime.on_gpu:
        return _base(source, device, "the device was asked for")
    try:
        file = _file(source, runtime, choice.file, say)
        keep = file.parent / f"compiled-{machine.fingerprint}" if runtime.library == "OpenVINO" else None
        network = runtime.load(file, compat=source.compat, streams=streams, keep=keep)
    except (ZoeDepthError, OSError) as error:
        if runtime.library == BASE.library:
            raise
        return _base(source, device, f"{runtime.name} was chosen and cannot be had: {error}")
    precision = runtime.precision if runtime.suffix is None else "float32"
    return Fast(network, runtime.name, choice.why, precision, device if runtime.on_gpu else "cpu")


def _base(source: Source, device: str, why: str) -> Fast:
    """Load a model in torch, in float32."""
    return Fast(BASE.load(source.path, compat=source.compat), BASE.name, why, "float32", device)


def _file(source: Source, runtime: Runtime, kept: str, say: Callable[[str], object]) -> Path:
    """Return the file that a runtime loads: the weights, or an exported file."""
    if runtime.suffix is None:
        return source.path
    if runtime.numbers == "int8":
        return Path(kept)
    return exported_file(source, runtime, tell=say)


def decide(
    source: Source,
    machine: Machine,
    *,
    tell: Callable[[str], object] = lambda _: None,
    measure: Callable[[bool], dict[str, float]] | None = None,
    compare: "Callable[[Predictor, Predictor], tuple[float, float]] | None" = None,
) -> tuple[Choice, bool]:
    """Choose a runtime for a model of which no benchmark was run here.

    Args:
        source: the model.
        machine: this machine.
        tell: called with a sentence before something that takes long.
        measure: see ``products``.
        compare: compares a predictor in float32 with one in bfloat16: REL, and how many times faster the second is;
            None: ``compare_predictors``.

    Returns:
        The choice, and whether it will hold: False where a runtime could not be tried that may be there the next time.
    """
    packaged = packaged_graph(source) is not None
    chosen = BASE
    holds = True
    reasons: list[str] = []
    if machine.accelerator is not None:
        chosen = Runtime(BASE.library, "float32", on_gpu=True)
    else:
        for library in order(packaged=packaged):
            runtime = Runtime(library, "float32")
            if runtime.missing(machine, packaged=packaged):
                continue
            try:
                _file(source, runtime, "", tell)
            except (ZoeDepthError, OSError) as error:
                # A model that another runtime cannot hold stays so. A full disk does not.
                holds = holds and not isinstance(error, FullDiskError | OSError)
                reasons.append(f"{library} was left out: {error}")
                continue
            chosen = runtime
            break
    reasons.insert(0, "a GPU is here" if chosen.on_gpu else "fastest of docs/performance.md that is installed here")
    half = Runtime(chosen.library, "bfloat16", chosen.on_gpu)
    if half.name in RUNTIMES and (problem := half.missing(machine)):
        reasons.append(f"{half.name} was left out: {problem}")
    elif half.name in RUNTIMES:
        with threads(cpu_count()):  # all, whatever the photos that will be computed at the same time have each
            found = products(machine, measure=measure)
        ratio = found["bfloat16"] / found["float32"]
        reasons.append(f"products in bfloat16 are {ratio:.2f} times as fast as in float32 here")
        if ratio > FAST_PRODUCTS:
            tell(f"Comparing {half.name} with float32, once")
            try:
                with threads(cpu_count()):
                    rel, times = (compare or compare_predictors)(
                        *(_predictor(source, runtime, tell) for runtime in (chosen, half))
                    )
            except (ZoeDepthError, OSError) as error:
                # The model has been exported: this is a lack of memory, or of room.
                holds = holds and not isinstance(error, InputError | OSError)
                reasons.append(f"bfloat16 failed: {error}")
            else:
                reasons.append(f"the model is {times:.2f} times as fast, with a REL of {rel:.1e}")
                if rel <= allowed_rel(len(EXAMPLES)) and times >= _WORTH_IT:
                    chosen = half
    choice = Choice(
        chosen.name,
        "; ".join([*reasons, "zoedepth benchmark measures more"]),
        source.weights,
        machine,
        versions(),
        date.today().isoformat(),
    )
    return choice, holds


def order(*, packaged: bool) -> tuple[Library, ...]:
    """Return the libraries for float32 on the CPU, the fastest first, see above.

    Args:
        packaged: the model is that of the package, with its graph.
    """
    return ("OpenVINO", "ONNX Runtime", "torch") if packaged else ("OpenVINO", "torch")


def compare_predictors(base: Predictor, other: Predictor) -> tuple[float, float]:
    """Return the largest REL that another predictor has on the photos of the package, and how many times faster it is.

    The REL is infinite where a depth is not finite. They take turns on the first photo, and the fastest of three times
    counts.
    """
    images = [read_image(photo) for photo in EXAMPLES]
    expected, depths = ([predictor(image).depth for image in images] for predictor in (base, other))
    try:
        rel = largest_rel(depths, expected)
    except InputError:
        rel = math.inf
    seconds: dict[Predictor, list[float]] = {base: [], other: []}
    for _ in range(3):
        for predictor, times in seconds.items():
            started = time.perf_counter()
            predictor(images[0])
            times.append(time.perf_counter() - started)
    return rel, min(seconds[base]) / min(seconds[other])


def _predictor(source: Source, runtime: Runtime, tell: Callable[[str], object]) -> Predictor:
    network = runtime.load(_file(source, runtime, "", tell), compat=source.compat)
    return Predictor(
        network,
        device="auto" if runtime.on_gpu else "cpu",
        precision=runtime.precision if runtime.suffix is None else "float32",
        camera="none",
    )
