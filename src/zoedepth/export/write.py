"""Write a model for other programs, and check that they compute the same depth."""

import json
import logging
import math
import mmap
import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from functools import partial
from importlib.util import find_spec
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from zoedepth import __version__
from zoedepth.config import ModelConfig, NewCrfsConfig, NewCrfsNetworkConfig, to_dict
from zoedepth.errors import FullDiskError, InputError, MissingExtraError, ZoeDepthError, is_no_memory
from zoedepth.export.first_layers import keep_in_float32
from zoedepth.export.int8 import TOLERANCE_INT8, mean_rel, prepared, quantized, some
from zoedepth.export.wrapper import ExportModel
from zoedepth.model.interface import DepthModel
from zoedepth.pixels import resize_pixels
from zoedepth.weights.exported import METADATA, ExportedModel, load_exported
from zoedepth.weights.tensors import DOMAIN, INPUT, Exported

Format = Literal["onnx", "openvino", "torch-export"]
SUFFIXES: dict[Format, str] = {"onnx": ".onnx", "openvino": ".xml", "torch-export": ".pt2"}
OPSET = 18
TOLERANCE = 1e-4
"""Largest median of |exported - torch| / torch that is allowed for any output in metres."""


class ExportError(ZoeDepthError):
    """Error of an export that does not compute what torch computes."""


def export_model(
    model: DepthModel | ExportedModel,
    path: str | Path,
    *,
    to: Format,
    int8: bool = False,
    photos: Sequence[str | Path] = (),
    size: tuple[int, int] | None = None,
    accuracy_control: bool = True,
    tell: Callable[[str], object] = lambda _: None,
) -> float:
    """Write a model for another program, run the file, and keep it only if its depth is the same as torch's.

    ``weights/tensors.py`` names the inputs and outputs. Batch, height and width are free; in a torch-export, and for
    encoders with one size, only the batch is. Config, preprocessing and version are in the metadata.

    Args:
        model: model in evaluation mode.
        path: file to write, with the suffix of the format; OpenVINO's weights go to a .bin beside it.
        to: onnx, openvino or torch-export.
        int8: compute products of encoder and decoder in 8-bit integers (OpenVINO); heads and router stay in float32.
        photos: photos to calibrate int8 on; a few hundred like those that the model will see.
        size: (height, width) of a torch-export, whose size is fixed; None: the model's.
        accuracy_control: False makes no second attempt at int8 with more layers in float32, which takes long.
        tell: called with a sentence before something that takes long.

    Returns:
        The difference that the check found: the largest median relative difference, or the mean one over photos in
        int8.

    Raises:
        InputError: the model cannot be exported (see ``ExportModel``), the size is wrong, the disk is full, or what
            ``check_wish`` refuses.
        ExportError: the exported depth differs; nothing is left behind.
        MissingExtraError: the format's library is not installed.
    """
    path = Path(path)
    check_wish(path, to=to, int8=int8, calibrated=bool(photos), size=size)
    if isinstance(model, ExportedModel):
        raise InputError("the model is an exported file already: export the model that it was made from")
    _check_model(model, to=to, size=size)
    wrapped = ExportModel(model).eval()
    path.parent.mkdir(parents=True, exist_ok=True)
    _check_room(model, path.parent)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".export-") as name:
        part = Path(name) / path.name
        try:
            with _without_chatter():
                quantize = partial(quantized, model, photos=photos, accuracy_control=accuracy_control, tell=tell)
                difference = _write(
                    model,
                    wrapped,
                    part,
                    to=to,
                    photos=photos if int8 else (),
                    quantize=quantize,
                    size=size or model.config.size,
                )
        except RuntimeError as error:  # the errors of all exporters are kinds of it
            if is_no_memory(error):
                raise
            raise ExportError(f"{to} cannot hold this model: {str(error)[:300]}") from error
        for file in sorted(part.parent.iterdir()):  # .bin before .xml, which needs it
            shutil.move(file, path.parent / file.name)
    return difference


def check_wish(
    path: Path, *, to: Format, int8: bool = False, calibrated: bool = True, size: tuple[int, int] | None = None
) -> None:
    """Refuse what cannot be written whatever the model is, before one is loaded.

    Args:
        path: file to write.
        to: onnx, openvino or torch-export.
        int8: see ``export_model``.
        calibrated: False if there are no photos to calibrate int8 on.
        size: see ``export_model``.

    Raises:
        InputError: the suffix is wrong, the file is there and is not an export, int8 is asked for without photos or in
            another format, or a size in another format than torch-export.
        MissingExtraError: the format's library is not installed.
    """
    if path.suffix != SUFFIXES[to]:
        raise InputError(f"a file of {to} ends with {SUFFIXES[to]}: give another name than {path.name}")
    _check_target(path)
    if int8 and to != "openvino":
        raise InputError(f"int8 is for openvino only, not for {to}: export to openvino, or leave int8 out")
    if int8 and not calibrated:
        raise InputError("int8 needs photos to calibrate on, like those the model will see: give a folder of them")
    if size is not None and to != "torch-export":
        raise InputError(f"a file of {to} takes any size: leave the size out, which is for torch-export")
    needed = {"onnx": ("onnx", "onnxruntime"), "openvino": ("onnx", "openvino"), "torch-export": ()}[to]
    for module in (*needed, *(("nncf",) if int8 else ())):
        if find_spec(module) is None:
            raise MissingExtraError(to, f"export to {to}")


_OWN = re.compile(
    # Behind the key come the filler of torch's archives, the length of a text in ONNX, or the attribute of an XML.
    rb'%s(?:FB..Z{0,64}|\x12[\x80-\xff]{0,4}.| value=")?\{(?:"|&quot;)config(?:"|&quot;)' % METADATA.encode(),
    re.DOTALL,
)
"""The metadata, which no format compresses: its key, and the beginning of the JSON. The key alone stands in files of
others, too: in names of modules, and in paths of source files."""


def _check_target(path: Path) -> None:
    """Refuse to replace a file that no export has written, or the .bin file of something else."""
    weights = path.with_suffix(".bin")
    if path.suffix == SUFFIXES["openvino"] and weights.exists() and not path.exists():
        raise InputError(
            f"{weights} is there already, and OpenVINO would replace it: give another name than {path.name}"
        )
    if not os.path.lexists(path):  # a link that leads nowhere is there
        return
    if path.is_file() and path.stat().st_size:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if _OWN.search(content):
                return
    raise InputError(f"{path} is there already, and is not an export of zoedepth: give another name, or move it away")


def _check_room(model: DepthModel, folder: Path) -> None:
    """Refuse a disk that has no room for the weights, twice: for the file, and for the one it is made from."""
    needed = 2 * sum(weight.numel() * weight.element_size() for weight in model.parameters())
    if (free := shutil.disk_usage(folder).free) < needed:
        raise FullDiskError(
            f"the disk of {folder} has {free:,} bytes free, and the export needs about {needed:,}: make room, or write "
            "to another place"
        )


def _check_model(model: DepthModel, *, to: Format, size: tuple[int, int] | None) -> None:
    """Refuse models that cannot be written, see ``export_model``."""
    if model.training:
        raise InputError("the model is in training mode: call model.eval() first")
    config = model.config
    if size is not None and any(side < 1 or side % config.multiple for side in size):
        raise InputError(f"the sides of a network input are multiples of {config.multiple}: got {size}")
    if config.one_size and size not in (None, config.size):
        raise InputError(f"{config.encoder_name} takes pixels of {config.size} only")
    parts = config.head if isinstance(config, ModelConfig) else config.network
    if to != "torch-export" and isinstance(parts, NewCrfsConfig | NewCrfsNetworkConfig):
        raise InputError("NeWCRFs cuts a photo into windows by its size, which fits torch-export only: export to that")
    if model.dtype != torch.float32:
        raise InputError(f"the weights are {model.dtype}, and exports compute in float32: call model.float() first")
    if model.device.type != "cpu":
        raise InputError("the model is on another device than the CPU, where the check runs: call model.cpu() first")


def _write(
    model: DepthModel,
    wrapped: ExportModel,
    path: Path,
    *,
    to: Format,
    photos: Sequence[str | Path],
    quantize: Callable[[Any], Any],
    size: tuple[int, int],
) -> float:
    """Write and check in one of the formats, with photos in 8 bits. Return the difference."""
    if to == "torch-export":
        _write_program(wrapped, path, size)
        return _check_program(wrapped, path, size)
    graph = path.with_suffix(".onnx")
    write_onnx(wrapped, graph)
    if to == "onnx":
        _complete_onnx(model, graph)
        return _check(model, path)
    _write_openvino(model, graph, path, quantize if photos else None)
    graph.unlink()
    return _check_int8(model, path, photos) if photos else _check(model, path)


def metadata(model: DepthModel) -> str:
    """Return as JSON what a program must know to prepare photos and to read the depth."""
    config, about = model.config, model.provenance
    return json.dumps({
        "config": to_dict(config),
        "preprocessing": {
            "input": f"{INPUT}: float32 (batch, 3, height, width), RGB / 255, normalised inside",
            "size": config.size,
            "multiple": config.multiple,
            "resize": "keep-aspect" if config.keep_aspect_ratio else "squeeze",
            "interpolation": "bilinear, antialias" if config.antialias else "bilinear, align_corners",
            "pad": "reflect by 3 sqrt(side / 2), cut off after" if config.pad else "none",
        },
        "postprocessing": "resize predicted_depth to the photo: bicubic; mean with the mirrored photo's, mirrored back",
        "std": "of the bins, in metres like predicted_depth: multiply it by std_factor of the domain (config) too",
        "unit": "metre",
        "camera": _CANONICAL if config.canonical_camera else _ANY_CAMERA,
        "domains": [domain.name for domain in config.domains],
        "licence": about.licence,
        "trained_on": about.trained_on,
        "zoedepth": __version__,
    })  # fmt: skip


_CANONICAL = (
    "predicted_depth is in metres of one camera: multiply it by the photo's focal length in pixels of the network's "
    "input, and divide it by focal_px of the domain (config)"
)
_ANY_CAMERA = "predicted_depth needs no camera; its metres hold for lenses like those that the model was trained with"


def _inputs(model: DepthModel, batch: int, size: tuple[int, int]) -> tuple[Tensor, ...]:
    """Make inputs to trace with: smooth colours, and -1 (the router's choice) if there are several heads."""
    pixels = _pixels(batch, size)
    return (pixels, torch.full((batch,), -1)) if len(model.config.domains) > 1 else (pixels,)


def write_onnx(wrapped: ExportModel, path: Path, *, fold: bool = True) -> None:
    """Write the graph of a model, unchecked, without metadata.

    Args:
        wrapped: the model.
        path: file to write.
        fold: True merges each batch norm into the weights before it. False keeps all weights, under their own names.
    """
    config = wrapped.model.config
    # Not the size that the position tables fit: nothing would be resized in the traced graph.
    size = config.size if config.one_size else (3 * config.multiple, 4 * config.multiple)
    if size == config.size and not config.one_size:
        size = (size[0], size[1] + config.multiple)
    inputs = _inputs(wrapped.model, 2, size)
    names = [name for name, x in zip(Exported._fields, wrapped.outputs(*inputs), strict=True) if x is not None]
    sides = {} if config.one_size else {"height": -2, "width": -1}
    axes = {INPUT: {0: "batch"} | {4 + at: side for side, at in sides.items()}, "domain_logits": {0: "batch"}}
    for name in names:
        axes.setdefault(name, {0: "batch"} | {3 + at: side for side, at in sides.items()})
    axes[DOMAIN] = {0: "batch_or_1"}
    # Traced, because torch.export takes minutes with free sizes (docs/log.md). With gradients, because heads compute in
    # pieces without them, and the trace would have all pieces.
    with warnings.catch_warnings(), torch.enable_grad():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            wrapped, inputs, path, input_names=[INPUT, DOMAIN][: len(inputs)], output_names=names,
            dynamic_axes=axes, opset_version=OPSET, dynamo=False, do_constant_folding=fold,
            training=torch.onnx.TrainingMode.EVAL if fold else torch.onnx.TrainingMode.PRESERVE,
        )  # fmt: skip


def _complete_onnx(model: DepthModel, path: Path) -> None:
    import onnx

    graph = onnx.load(path)
    complete(graph, model)
    onnx.save(graph, path)


def complete(graph: Any, model: DepthModel) -> None:
    """Add the metadata to a graph of ONNX, and the value of the second input for programs that leave it out."""
    import onnx

    entry = graph.metadata_props.add()
    entry.key, entry.value = METADATA, metadata(model)
    if len(model.config.domains) > 1:
        graph.graph.initializer.append(onnx.helper.make_tensor(DOMAIN, onnx.TensorProto.INT64, [1], [-1]))


def _write_openvino(model: DepthModel, graph: Path, path: Path, quantize: Callable[[Any], Any] | None) -> None:
    import openvino

    with _without_telemetry():
        converted = openvino.convert_model(graph)
        if quantize is not None:
            converted = quantize(converted)
    converted.set_rt_info(metadata(model), METADATA)
    openvino.save_model(converted, path, compress_to_fp16=False)
    if isinstance(model.config, ModelConfig) and model.config.encoder.family == "convolutional":
        keep_in_float32(path)


@contextmanager
def _without_chatter() -> Iterator[None]:
    """Hide what exporters print, warn of and log: bars of NNCF on standard output, and advice to their authors."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(), redirect_stdout(StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


@contextmanager
def _without_telemetry() -> Iterator[None]:
    """Run OpenVINO's converter and NNCF without the statistics that they send to their makers.

    They send none from CI jobs, which they tell by these variables. Each message would start a process of its own, too.
    """
    names = ("CI", "NNCF_CI")
    before = {name: os.environ[name] for name in names if name in os.environ}
    os.environ.update(dict.fromkeys(names, "true"))
    try:
        yield
    finally:
        for name in names:
            del os.environ[name]
        os.environ.update(before)


def _write_program(wrapped: ExportModel, path: Path, size: tuple[int, int]) -> None:
    inputs = _inputs(wrapped.model, 2, size)
    shapes = ({0: torch.export.Dim("batch", min=1, max=1024)},) * len(inputs)
    with torch.enable_grad():
        program = torch.export.export(wrapped, inputs, dynamic_shapes=shapes, strict=False)
    archive = BytesIO()  # torch ends the whole process where its own writer meets a full disk
    torch.export.save(program, archive, extra_files={METADATA: metadata(wrapped.model)})
    path.write_bytes(archive.getbuffer())


@torch.no_grad()
def _check_program(wrapped: ExportModel, path: Path, size: tuple[int, int]) -> float:
    run = torch.export.load(path).module()
    worst = 0.0
    for batch in (1, 2):
        inputs = _inputs(wrapped.model, batch, size)
        for found, expected in zip(run(*inputs), wrapped(*inputs), strict=True):
            worst = max(worst, _difference(found, expected))
    return _within(worst, TOLERANCE, path)


@torch.no_grad()
def _check_int8(model: DepthModel, path: Path, photos: Sequence[str | Path]) -> float:
    """Compare with torch on some of the photos. 8 bits are scaled for these and promise nothing for other inputs."""
    exported, found, expected = load_exported(path), [], []
    for photo in some(photos):
        pixels = torch.from_numpy(prepared(model, photo))
        said = exported(pixels)
        found.append(said.depth.numpy())
        expected.append(model(pixels, domain=said.domain).depth.numpy())
    rel = mean_rel(found, expected)
    if rel > TOLERANCE_INT8:
        raise ExportError(
            f"{path.name} gives other depth in int8 than in float32: on {len(found)} photos the mean relative "
            f"difference is {rel:.2g}, and {TOLERANCE_INT8:.2g} is allowed. The file was not kept: calibrate on more "
            "photos, or export in float32"
        )
    return rel


@torch.no_grad()
def _check(model: DepthModel, path: Path) -> float:
    """Compare with torch at three sizes if sizes are free, for one image and for two that take different heads."""
    exported, config = load_exported(path), model.config
    multiple = config.multiple
    others = [(4 * multiple, 3 * multiple), (2 * multiple, 5 * multiple)]
    sizes = [config.size] if config.one_size else [config.size, *others]
    n_domains, worst = len(config.domains), 0.0
    for size in sizes:
        for batch in (1,) if size == config.size and not config.one_size else (1, 2):  # the largest takes long
            pixels = _pixels(batch, size)
            for domain in (None, torch.arange(batch) % n_domains, (torch.arange(batch) + 1) % n_domains):
                found = exported(pixels, domain=domain, return_std=True)
                expected = model(pixels, domain=found.domain, return_std=True)
                worst = max(worst, _difference(found.depth, expected.depth))
                if domain is None and expected.domain_logits is not None:
                    _within(_difference(found.domain_logits, expected.domain_logits), 100 * TOLERANCE, path)
                if expected.std is not None:
                    worst = max(worst, _difference(found.std, expected.std))
    return _within(worst, TOLERANCE, path, advice=": a model that decides by the size of photos fits torch-export only")


def _pixels(batch: int, size: tuple[int, int]) -> Tensor:
    """Make smooth colours. Noise alone has the same depth everywhere."""
    generator = torch.Generator().manual_seed(batch + size[0])
    coarse = torch.rand(batch, 3, 4, 5, generator=generator)
    noise = 0.1 * torch.rand(batch, 3, *size, generator=generator)
    return (0.9 * resize_pixels(coarse, size, antialias=False) + noise).clamp(0, 1)


def _difference(found: Tensor | None, expected: Tensor | None) -> float:
    if found is None or expected is None or found.shape != expected.shape:
        return math.inf
    difference = (found - expected).abs() / expected.abs().clamp(min=1e-6)
    return float(difference.median()) if bool(found.isfinite().all()) else math.inf


def _within(difference: float, tolerance: float, path: Path, *, advice: str = "") -> float:
    if difference > tolerance:
        raise ExportError(
            f"{path.name} gives other depth than torch: the median relative difference is {difference:.2g}, and "
            f"{tolerance:.2g} is allowed. The file was not kept{advice}"
        )
    return difference
