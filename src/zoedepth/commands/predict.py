"""``zoedepth predict``: depth maps of photos, folders and globs, as files."""

import glob
import json
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from zoedepth import __version__
from zoedepth.colors import colorize, preview_relative
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.images import (
    IMAGE_SUFFIXES,
    PNG_MAX,
    PNG_SCALE_MILLIMETRE,
    DepthArray,
    atomic_path,
    read_image,
    write_depth_png,
    write_image,
    write_relative_png,
)
from zoedepth.images import png_scale as fitting_scale

if TYPE_CHECKING:
    from zoedepth.predict import DepthMap, Predictor

EXIT_FAILED, EXIT_NOTHING_TO_DO, EXIT_INTERRUPTED = 1, 2, 130


def predict(
    sources: tyro.conf.Positional[tuple[str, ...]],
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    model: str = "zoed-lite",
    preview: bool = True,
    flip: bool = True,
    pad: Literal["model", "yes", "no"] = "model",
    domain: str | None = None,
    relative: bool = False,
    compat: tuple[str, ...] = (),
    png_scale: float | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
    colormap: str = "magma_r",
    device: str = "auto",
    precision: Literal["float32", "bfloat16"] = "float32",
    workers: int = 0,
) -> int:
    """Depth in metres of photos: a 16-bit PNG, a colour preview and a JSON sidecar of each.

    The tree of a folder is kept. A photo that cannot be read is reported and skipped. Exit codes: 0 all done, 1 some
    failed, 2 nothing to do, 130 interrupted.

    Args:
        sources: photos, folders (searched with their subfolders) and globs ("photos/**/*.jpg").
        out: folder to write to: NAME_depth.png, NAME_preview.jpg and NAME.json of each photo.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or a file of
            `zoedepth export`.
        preview: write the colour preview, the photo beside its depth with a bar in metres.
        flip: average with the prediction for the mirrored photo; half as fast, smoother.
        pad: reflect the borders outwards before the network, against artefacts at the border: as the model was made
            for (the released ones: yes; zoed-lite: no), or as you say.
        domain: scene type whose head to use, e.g. indoor; None leaves it to the model's router, photo by photo.
        relative: write relative depth (inverse, without a unit) instead: NAME_relative.png, the nearest 65535. Models
            without a metric head (MiDaS) give nothing else; of others it is a look inside that no loss kept right.
        compat: behaviours of the original code to take over: batch-vote, 10m, squeeze.
        png_scale: levels per metre of the PNG. None: 1000 (millimetres), or 256 for a depth map beyond 65.535 m.
        vmin: depth of the first colour in metres; None: from each photo. Set both to compare previews.
        vmax: depth of the last colour in metres; None: from each photo.
        colormap: magma, turbo, gray or Spectral, reversed with _r at the end.
        device: cpu, cuda, mps, or auto for the best there is.
        precision: bfloat16 is faster on hardware made for it.
        workers: photos computed at the same time, each from file to files; 0: as many as there are cores. Each needs
            memory of its own: 1 for large models where there is little.
    """
    console = Console(stderr=True, highlight=False)
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file: give a folder")
    if workers < 0:
        raise InputError(f"--workers must be 0 or more, got {workers}")
    # A wrong option is the caller's one mistake, not that of a thousand photos: found now.
    if png_scale is not None and not 0 < png_scale < float("inf"):
        raise InputError(f"--png-scale is levels per metre and must be positive, got {png_scale}")
    colorize(np.ones((1, 1)), vmin=vmin, vmax=vmax, colormap=colormap)
    found = find_photos(sources, out)
    if not found.photos:
        for failure in found.failures:
            console.print(f"[red]{escape(failure)}[/]", soft_wrap=True)
        searched = ", ".join(sources) or "no source given"
        console.print(f"No photos to predict ({escape(searched)}; {found.n_ignored} other files).", soft_wrap=True)
        return EXIT_NOTHING_TO_DO

    import torch

    from zoedepth.predict import Predictor
    from zoedepth.weights.load import load_model

    workers = min(workers or cpu_count(), len(found.photos))
    threads = torch.get_num_threads()
    if workers > 1:
        # Photos side by side, a core each: the threads of one forward wait for each other all the time.
        torch.set_num_threads(max(1, cpu_count() // workers))
    try:
        network = load_model(model, compat=compat, precision=precision, streams=workers)
        relative = relative or not network.config.domains
        if relative and (domain is not None or png_scale is not None or vmin is not None or vmax is not None):
            raise InputError("relative depth has no metres: leave out --domain, --png-scale, --vmin and --vmax")
        padded = None if pad == "model" else pad == "yes"
        predictor = Predictor(network, flip_average=flip, pad=padded, device=device, precision=precision)
        if domain is not None:
            predictor.domain_index(domain)
        writer = _Writer(model, preview=preview, png_scale=png_scale, vmin=vmin, vmax=vmax, colormap=colormap)
        return _run(found, predictor, writer, domain=domain, relative=relative, workers=workers, console=console)
    finally:
        torch.set_num_threads(threads)


@dataclass(frozen=True)
class Photo:
    """A photo to predict, and where its files go."""

    path: Path
    target: Path
    """The outputs without their endings: <out>/<folder>/<name>."""

    @property
    def depth_path(self) -> Path:
        """16-bit PNG."""
        return self.target.with_name(f"{self.target.name}_depth.png")

    @property
    def relative_path(self) -> Path:
        """16-bit PNG, where relative depth is asked for."""
        return self.target.with_name(f"{self.target.name}_relative.png")

    @property
    def preview_path(self) -> Path:
        """Colour preview."""
        return self.target.with_name(f"{self.target.name}_preview.jpg")

    @property
    def sidecar_path(self) -> Path:
        """JSON, written last: where it is, the other files are complete."""
        return self.target.with_name(f"{self.target.name}.json")


@dataclass
class Found:
    """What the sources named."""

    photos: list[Photo] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    """One message for each source or folder that could not be read."""
    n_ignored: int = 0
    """Files in folders and globs that are no photos by their suffix, hidden, or this command's own output."""


def find_photos(sources: Iterable[str], out: Path) -> Found:
    """The photos named by files, folders and globs, each once, each with outputs of its own.

    A photo's outputs are <out>/<its folder below the source>/<stem>. With several folders each keeps its own name in
    the tree. Photos that would share outputs (a.jpg and a.png) take their whole name (a.jpg, a.png), then a number.
    """
    sources, found = list(sources), Found()
    several_folders = sum(Path(source).is_dir() for source in sources) > 1
    places: dict[str, tuple[Path, Path]] = {}  # absolute path -> the photo and its place in the tree

    def add(path: Path, place: Path) -> None:
        places.setdefault(os.path.abspath(path), (path, place))

    for source in sources:
        path = Path(source)
        if path.is_dir():
            files, root = list(_walk(path, found)), path
            above = path.resolve().name if several_folders else ""
        elif path.exists():
            add(path, Path(path.name))  # named one by one: tried whatever its suffix
            continue
        elif glob.has_magic(source):
            matches = [Path(match) for match in sorted(glob.glob(source, recursive=True))]
            files, root, above = [match for match in matches if match.is_file()], _fixed_part(source), ""
            if not files:
                found.failures.append(f"{source}: matches no file")
        else:
            found.failures.append(f"{source}: no such file or folder")
            continue
        for file in files:
            if file.suffix.lower() in IMAGE_SUFFIXES and not _is_own_output(file, out):
                add(file, above / file.relative_to(root))
            else:
                found.n_ignored += 1
    found.photos = _with_targets(list(places.values()), out)
    return found


def _walk(folder: Path, found: Found) -> Iterator[Path]:
    """Files below a folder in a fixed order, without hidden ones (".cache", macOS's "._photo.jpg")."""

    def unreadable(error: OSError) -> None:
        found.failures.append(f"{error.filename}: {error.strerror}")

    for where, folders, files in os.walk(folder, onerror=unreadable):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        found.n_ignored += sum(name.startswith(".") for name in files)
        yield from (Path(where, name) for name in sorted(files) if not name.startswith("."))


def _fixed_part(pattern: str) -> Path:
    """The folders of a glob before its first wildcard."""
    parts = Path(pattern).parts
    n_fixed = next(i for i, part in enumerate(parts) if glob.has_magic(part))
    return Path(*parts[:n_fixed])


def _is_own_output(file: Path, out: Path) -> bool:
    """Whether an earlier run wrote the file, which matters when photos are searched where depth is written."""
    for ending in ("_depth.png", "_relative.png", "_preview.jpg"):
        if file.name.endswith(ending) and out.resolve() in file.resolve().parents:
            return file.with_name(file.name.removesuffix(ending) + ".json").exists()
    return False


def _with_targets(photos: list[tuple[Path, Path]], out: Path) -> list[Photo]:
    def key(place: Path) -> str:
        return str(place).casefold()  # a.jpg and A.png share their outputs on Windows and macOS

    n_sharing = Counter(key(place.with_suffix("")) for _, place in photos)
    taken: set[str] = set()

    def names(place: Path) -> Iterator[Path]:
        if n_sharing[key(place.with_suffix(""))] == 1:
            yield place.with_suffix("")
        yield place
        yield from (place.with_name(f"{place.name}-{number}") for number in count(2))

    targets = []
    for path, place in photos:
        name = next(name for name in names(place) if key(name) not in taken)
        taken.add(key(name))
        targets.append(Photo(path, out / name))
    return targets


@dataclass
class _Writer:
    """Writes the files of a photo, and remembers what is worth saying at the end."""

    model: str
    preview: bool
    png_scale: float | None
    vmin: float | None
    vmax: float | None
    colormap: str
    n_written: int = 0
    n_rescaled: int = 0
    n_clipped: int = 0
    lock: Lock = field(default_factory=Lock)

    def write(self, photo: Photo, result: "DepthMap", *, trained_size: tuple[int, int], seconds: float) -> None:
        """Depth, preview, then the sidecar."""
        depth = result.depth
        scale = fitting_scale(depth) if self.png_scale is None else self.png_scale
        write_depth_png(photo.depth_path, depth, scale=scale)
        files = {"depth": photo.depth_path.name}
        if self.preview:
            write_image(photo.preview_path, result.preview(vmin=self.vmin, vmax=self.vmax, colormap=self.colormap))
            files["preview"] = photo.preview_path.name
        confidence = None if result.confidence is None else round(float(np.median(result.confidence)), 4)
        sidecar = {
            "source": str(photo.path),
            "model": self.model,
            "config_size": trained_size,
            "input_size": result.size,
            "network_size": result.network_size,
            "domain": result.domain,
            "domain_probability": _rounded(result.domain_probability),
            "unit": "metre",
            "png_scale": scale,
            "depth": _rounded({"min": depth.min(), "median": np.median(depth), "max": depth.max()}),
            "median_confidence": confidence,
            "files": files,
            "zoedepth": __version__,
            "seconds": round(seconds, 3),
        }
        self._write_sidecar(photo, sidecar)
        with self.lock:
            self.n_rescaled += self.png_scale is None and scale != PNG_SCALE_MILLIMETRE
            self.n_clipped += bool(depth.max() * scale > PNG_MAX)

    def write_relative(self, photo: Photo, relative: DepthArray, *, seconds: float) -> None:
        """The same of relative depth, which has no unit."""
        low, high = write_relative_png(photo.relative_path, relative)
        files = {"relative": photo.relative_path.name}
        if self.preview:
            write_image(photo.preview_path, preview_relative(read_image(photo.path), relative))
            files["preview"] = photo.preview_path.name
        sidecar = {
            "source": str(photo.path),
            "model": self.model,
            "input_size": relative.shape,
            "unit": "none: inverse depth up to an unknown scale and shift, near is large",
            "png_range": [low, high],
            "files": files,
            "zoedepth": __version__,
            "seconds": round(seconds, 3),
        }
        self._write_sidecar(photo, sidecar)

    def _write_sidecar(self, photo: Photo, sidecar: Mapping[str, object]) -> None:
        with atomic_path(photo.sidecar_path) as temporary:
            temporary.write_text(json.dumps(sidecar, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        with self.lock:
            self.n_written += 1


def _run(
    found: Found,
    predictor: "Predictor",
    writer: _Writer,
    *,
    domain: str | None,
    relative: bool,
    workers: int,
    console: Console,
) -> int:
    """Predict ``workers`` photos at a time, each from file to files; one that fails does not stop the others."""
    interrupted = False
    inputs = {os.path.abspath(photo.path) for photo in found.photos}

    def predict_one(photo: Photo) -> str | None:
        """What went wrong, if anything did."""
        try:
            depth_path = photo.relative_path if relative else photo.depth_path
            outputs = (depth_path, photo.preview_path, photo.sidecar_path)
            if clash := [path.name for path in outputs if os.path.abspath(path) in inputs]:
                raise InputError(f"its {clash[0]} would overwrite another photo, choose another --out")
            started = time.perf_counter()
            if relative:
                result = predictor.relative(photo.path)
                writer.write_relative(photo, result, seconds=time.perf_counter() - started)
            else:
                result = predictor(photo.path, domain=domain)
                seconds = time.perf_counter() - started
                writer.write(photo, result, trained_size=predictor.model.config.size, seconds=seconds)
        except ZoeDepthError as error:
            return f"{photo.path}: {error}"
        except Exception as error:  # disk full, out of memory: the rest of ten thousand may still go well
            return f"{photo.path}: {type(error).__name__}: {error}"
        return None

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    said: list[str | None] = []
    executor = ThreadPoolExecutor(workers)
    try:
        with Progress(*columns, console=console, transient=True) as progress:
            results = executor.map(predict_one, found.photos)
            said.extend(progress.track(results, total=len(found.photos), description="depth"))
    except KeyboardInterrupt:
        interrupted = True
    finally:
        executor.shutdown(cancel_futures=True)  # those that have begun are finished: no file is left half written
    failures = [*found.failures, *filter(None, said)]

    for failure in failures:
        console.print(f"[red]failed[/] {escape(failure)}", soft_wrap=True)
    if writer.n_rescaled:
        console.print(f"{writer.n_rescaled} reach beyond 65.535 m: their PNGs have 256 levels per metre, not 1000.")
    if writer.n_clipped:
        console.print(
            f"[yellow]{writer.n_clipped} clipped:[/] too far for the PNG scale; a smaller --png-scale fits more."
        )
    state = "Interrupted: " if interrupted else ""
    n_photos = len(found.photos)
    summary = (
        f"{state}{writer.n_written} of {n_photos} photos written, {len(failures)} failed, {found.n_ignored} other files"
    )
    console.print(summary, soft_wrap=True)
    return EXIT_INTERRUPTED if interrupted else EXIT_FAILED if failures else 0


def cpu_count() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(float(value), 4) for name, value in values.items()}
