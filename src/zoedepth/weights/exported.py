"""Run exported files, which takes no torch: arrays in and out, for ``Predictor``; tensors for programs in torch."""

import logging
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from jaxtyping import Float32, Int

from zoedepth.config import AnyModelConfig, model_config_from_dict
from zoedepth.errors import InputError, MissingExtraError, ZoeDepthError, is_no_memory
from zoedepth.provenance import Provenance, from_texts
from zoedepth.stored import parse_json
from zoedepth.threads import thread_count, wait_asleep
from zoedepth.weights.compiled import CompiledGraphs
from zoedepth.weights.openvino_graph import specialized
from zoedepth.weights.openvino_processor import EXACT, UNMERGED, adds_8_bits_exactly, has_bfloat16
from zoedepth.weights.releases import ASSETS
from zoedepth.weights.tensors import DOMAIN, INPUT, STD, Exported

if TYPE_CHECKING:
    import torch
    from jaxtyping import Float
    from torch import Tensor

    from zoedepth.model.interface import DepthOutput

_log = logging.getLogger(__name__)

METADATA = "zoedepth"
"""Key in the file's metadata of a JSON text with config, preprocessing and version."""
Precision = Literal["float32", "bfloat16", "float16"]


class ExportedModel(ABC):
    """Model in a file of another runtime. It runs on the CPU, cannot be trained, and has no relative depth.

    It can be called like a ``DepthModel``, and torch is imported then. ``compute`` does the same for arrays.

    Attributes:
        config: the config of the model from which it was exported.
        provenance: licence and training data of the weights, where they are known.
        path: the file.
        precision: the numbers that it computes in: "float32", "bfloat16" or "int8".
    """

    runtime: str
    """The library that computes."""
    precision: str = "float32"
    together: bool = False
    """True where images of a batch are computed together. A processor takes longer for that, and more memory."""

    def __init__(self, metadata: str | None, path: Path) -> None:
        self.path = path
        self.config, self.provenance = _read_metadata(metadata, path)

    @property
    def device(self) -> "torch.device":
        """Return the CPU: pixels and depth are there, wherever the runtime computes."""
        import torch

        return torch.device("cpu")

    def relative(self, pixels: Any) -> Any:
        """Refuse: exported files hold metres only.

        Raises:
            InputError: always.
        """
        raise InputError("an exported model has no relative depth: use the model that it was exported from")

    @abstractmethod
    def run(self, inputs: Mapping[str, np.ndarray], *, std: bool) -> Mapping[str, np.ndarray]:
        """Compute outputs by name from inputs by name. The standard deviation is left out unless it is wanted."""

    def compute(
        self,
        pixels: Float32[np.ndarray, "batch 3 height width"],
        domain: Int[np.ndarray, " batch"] | None = None,
        *,
        std: bool = True,
    ) -> Exported:
        """Compute the outputs of a batch as arrays of float32, see ``DepthModel.forward``.

        Args:
            pixels: RGB in [0, 1]; sides are multiples of ``config.multiple``.
            domain: index in ``config.domains`` of the head each image takes; None leaves it to the router.
            std: True to compute the standard deviation, where the file has it.

        Raises:
            InputError: the runtime cannot compute it.
        """
        heads = np.full(len(pixels), -1) if domain is None else domain.astype(np.int64)
        size = len(pixels) if self.together else 1
        parts = []
        for first in range(0, len(pixels), size):
            inputs = {INPUT: np.ascontiguousarray(pixels[first : first + size])}
            if len(self.config.domains) > 1:
                inputs[DOMAIN] = heads[first : first + size]
            parts.append(self.run(inputs, std=std))
        return Exported(
            *(
                np.concatenate([part[name] for part in parts]).astype(np.float32) if name in parts[0] else None
                for name in Exported._fields
            )
        )

    def __call__(
        self,
        pixels: "Float[Tensor, 'batch 3 height width']",
        *,
        domain: "Int[Tensor, ' batch'] | None" = None,
        return_std: bool = False,
        return_bins: bool = False,
    ) -> "DepthOutput":
        """Compute the depth of a batch, see ``DepthModel.forward``. Outputs that nobody asks for cost nothing.

        Raises:
            InputError: wrong shape or size, or bins or gradients are asked for, which exported files do not give.
        """
        if return_bins:
            raise InputError("an exported model gives no bins: load the model that it was exported from")
        import torch

        if torch.is_grad_enabled() and pixels.requires_grad:
            raise InputError("an exported model passes no gradients: load the model that it was exported from")

        from zoedepth.model.interface import DepthModel, DepthOutput

        DepthModel.check(cast(Any, self), pixels, domain)
        arrays = self.compute(
            pixels.detach().float().numpy(), None if domain is None else domain.numpy(), std=return_std
        )
        said = Exported(*(None if x is None else torch.from_numpy(x) for x in arrays))
        taken = torch.zeros(len(pixels), dtype=torch.long)
        if said.domain_logits is not None:
            taken = said.domain_logits.argmax(dim=1) if domain is None else domain.long()
        std = None if said.std is None else said.std[:, None]
        return DepthOutput(said.predicted_depth[:, None], None, taken, said.domain_logits, std, None, None)


_SPINNING = "session.intra_op.allow_spinning"
"""ONNX Runtime's option that lets its threads wait in a loop."""


class OnnxModel(ExportedModel):
    """ONNX file in ONNX Runtime: on CUDA where that is wanted and its GPU package is installed (not run), or the CPU.

    The graphs of the package always run on the CPU.
    """

    runtime = "ONNX Runtime"

    def __init__(self, path: Path, *, threads: int, device: str = "auto") -> None:
        checked = path.parent != ASSETS and path.stat().st_size <= _SMALL
        # It would make a number for this machine, and send it to its makers with the path of the program. It looks at
        # this when it is imported.
        os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
        try:
            import onnxruntime
        except ModuleNotFoundError as error:
            raise MissingExtraError("onnx", "running an ONNX file") from error
        onnxruntime.disable_telemetry_events()  # Windows' own
        self.options: dict[str, Any] = {"threads": threads, "device": device}
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3  # errors only: it warns of the default of the second input
        if wait_asleep():
            options.add_session_config_entry(_SPINNING, "0")
        wanted = ["CPUExecutionProvider"]
        if device != "cpu" and path.parent != ASSETS:  # those graphs run where the CPU was asked for
            wanted.insert(0, "CUDAExecutionProvider")
        providers = [name for name in wanted if name in onnxruntime.get_available_providers()]
        try:
            if checked:
                _refuse_onnx_bomb(path)
            self.session = onnxruntime.InferenceSession(str(path), options, providers=providers)
        except ZoeDepthError:
            raise
        except Exception as error:  # its errors share no class
            raise InputError(f"{path} cannot be read as ONNX: {str(error)[:300]}. Export the model again") from error
        self.names = [output.name for output in self.session.get_outputs()]
        self.together = "CUDAExecutionProvider" in self.session.get_providers()
        super().__init__(self.session.get_modelmeta().custom_metadata_map.get(METADATA), path)

    def __reduce__(self) -> tuple[Any, ...]:
        """Load the file again where the model is copied or unpickled: a session cannot be sent to a process."""
        return partial(load_exported, **self.options), (self.path.absolute(),)

    def run(self, inputs: Mapping[str, np.ndarray], *, std: bool) -> Mapping[str, np.ndarray]:
        """Compute outputs by name from inputs by name; see ``ExportedModel``."""
        names = [name for name in self.names if std or name != STD]
        try:
            found: Any = self.session.run(names, dict(inputs))
        except Exception as error:  # its errors share no class
            if is_no_memory(error):
                raise
            raise InputError(f"{self.path.name} cannot be run: {str(error)[:300]}. Export the model again") from error
        return dict(zip(names, found, strict=True))


class OpenVinoModel(ExportedModel):
    """OpenVINO file, compiled for this processor.

    The graph is compiled for the first shape of pixels that comes: that is faster and needs less memory than a graph
    for any shape. All other shapes share one graph for any shape, compiled when the first of them comes. Graphs with
    and without the standard deviation are compiled separately.
    """

    runtime = "OpenVINO"

    def __init__(self, path: Path, *, precision: Precision, threads: int, streams: int, keep: Path | None) -> None:
        try:
            import openvino
        except ModuleNotFoundError as error:
            raise MissingExtraError("openvino", "running an OpenVINO file") from error
        self.options: dict[str, Any] = {"precision": precision, "threads": threads, "streams": streams, "keep": keep}
        self.core = openvino.Core()
        self.kept = None if keep is None else CompiledGraphs(keep, self.core, path)
        self.properties = {
            "INFERENCE_PRECISION_HINT": {"float32": "f32", "bfloat16": "bf16"}[precision],
            "INFERENCE_NUM_THREADS": threads * streams,
            "NUM_STREAMS": streams,
        }
        try:
            self.graph = self.core.read_model(path)
            _refuse_openvino_bomb(self.graph, path)
            metadata = self.graph.get_rt_info(METADATA).astype(str) if self.graph.has_rt_info(METADATA) else None
        except InputError:
            raise
        except Exception as error:  # a RuntimeError of C++, mostly
            raise InputError(
                f"{path} cannot be read as OpenVINO: {str(error)[:300]}. Is its .bin file beside it?"
            ) from error
        quantized = any(node.get_type_name() == "FakeQuantize" for node in self.graph.get_ops())
        if quantized and not adds_8_bits_exactly():
            self.properties |= EXACT
            _log.warning(
                "%s computes in 8 bits, and this processor cuts off their sums (it has no VNNI): they are computed in "
                "float32. The depth is the same; an export in float32 is faster here",
                path,
            )
        # Where the processor has no bfloat16, OpenVINO takes no notice of the hint.
        computed = precision if precision == "float32" or has_bfloat16() else "float32"
        self.precision = "int8" if quantized else computed
        self.lock = Lock()
        self.first_shape: tuple[int, ...] | None = None
        self.compiled: dict[tuple[bool, bool], Any] = {}
        """(True for the first shape only, True with the standard deviation) → compiled graph."""
        super().__init__(metadata, path)

    def __reduce__(self) -> tuple[Any, ...]:
        """Load the file again where the model is copied or unpickled: a graph cannot be sent to a process."""
        return partial(load_exported, **self.options), (self.path.absolute(),)

    def run(self, inputs: Mapping[str, np.ndarray], *, std: bool) -> Mapping[str, np.ndarray]:
        """Compute outputs by name from inputs by name; see ``ExportedModel``. Several threads may call it at once."""
        compiled = self._compiled_for(inputs[INPUT].shape, std=std)
        try:
            results: Any = compiled.create_infer_request().infer(dict(inputs))
        except Exception as error:  # a RuntimeError of C++, mostly
            if is_no_memory(error):
                raise
            raise InputError(f"{self.path.name} cannot be run: {str(error)[:300]}. Export the model again") from error
        return {output.get_any_name(): np.array(results[output]) for output in compiled.outputs}

    def _compiled_for(self, shape: tuple[int, ...], *, std: bool) -> Any:
        with self.lock:
            self.first_shape = self.first_shape or shape
            key = (shape == self.first_shape, std)
            if key not in self.compiled:
                # Any other shape has a graph for all shapes, which is compiled each time.
                kept = self.kept if key[0] else None
                found = None if kept is None else kept.read(shape, std=std, properties=self.properties)
                self.compiled[key] = found or self._compile(shape if key[0] else None, std)
                if kept is not None and found is None:
                    kept.write(self.compiled[key], shape, std=std, properties=self.properties)
            return self.compiled[key]

    def _compile(self, shape: tuple[int, ...] | None, std: bool) -> Any:
        try:
            graph = specialized(self.graph, shape=shape, without=() if std else (STD,))
            try:
                return self.core.compile_model(graph, "CPU", self.properties)
            except RuntimeError as error:
                if _NO_REGISTERS not in str(error):
                    raise
                # It says so after all of its work: the next graph is compiled like this at once.
                self.properties |= UNMERGED
                return self.core.compile_model(graph, "CPU", self.properties)
        except Exception as error:  # a RuntimeError of C++, mostly
            if is_no_memory(error):
                raise
            raise InputError(
                f"OpenVINO cannot compile {self.path.name}: {str(error)[:300]}. Export the model again"
            ) from error


_NO_REGISTERS = "Can't allocate registers for a snippet"
"""Words of OpenVINO (2026.4) where it has merged more operations than a processor without AVX-512 has registers for: it
does so with five attractors and more. Without merging it compiles them (docs/log.md)."""


_SMALL = 100_000_000
"""Bytes of an ONNX file that is looked through before it is run; larger ones are no small files that unpack to more."""
_MAX_UNPACKED = 100_000_000
"""Bytes that a graph may make of constants, beside 16 times its file: 8-bit weights become float32, and are moved."""


def _refuse_onnx_bomb(path: Path) -> None:
    """Refuse a graph whose constants ask for tensors far larger than the file, or that has loops."""
    try:
        import onnx
        from onnx import shape_inference
    except ModuleNotFoundError as error:
        raise MissingExtraError("onnx", "running an ONNX file") from error

    model = onnx.load(path, load_external_data=False)
    if any(attribute.type == onnx.AttributeProto.GRAPH for node in model.graph.node for attribute in node.attribute):
        raise InputError(f"{path} has a loop or a branch, which no export of zoedepth has: it was not run")
    try:
        inferred = shape_inference.infer_shapes(model, data_prop=True)
    except Exception as error:  # its errors share no class
        raise InputError(f"{path} cannot be read as ONNX: {str(error)[:300]}. Export the model again") from error
    values = [*inferred.graph.value_info, *inferred.graph.output]
    _refuse_bomb([[dim.dim_value for dim in value.type.tensor_type.shape.dim] for value in values], path)


def _refuse_openvino_bomb(graph: Any, path: Path) -> None:
    """Refuse a graph whose constants ask for tensors far larger than its weights, or that has loops."""
    shapes = []
    for node in graph.get_ops():
        if node.get_type_name() in _SUBGRAPHS:
            raise InputError(f"{path} has a loop or a branch, which no export of zoedepth has: it was not run")
        if node.get_type_name() != "Constant":  # whose size OpenVINO compares with the .bin file
            shapes += [port.get_partial_shape() for port in node.outputs()]
    _refuse_bomb([[dim.get_min_length() for dim in shape] for shape in shapes if shape.rank.is_static], path)


_SUBGRAPHS = ("Loop", "TensorIterator", "If")
"""OpenVINO's operations that hold a graph of their own."""


def _refuse_bomb(shapes: list[list[int]], path: Path) -> None:
    """Refuse a graph by the shapes of its tensors, whose unknown sides are 0."""
    weights = path.with_suffix(".bin")
    n_bytes = path.stat().st_size + (weights.stat().st_size if weights.is_file() else 0)
    unpacked = sum(4 * math.prod(max(side, 1) for side in shape) for shape in shapes)
    if unpacked > _MAX_UNPACKED + 16 * n_bytes:
        raise InputError(
            f"{path} of {n_bytes:,} bytes would unpack to {unpacked:,}, which no export of zoedepth does: it was not "
            "run"
        )


_SUFFIXES = (".onnx", ".xml")


def is_exported(name_or_path: str | Path) -> bool:
    """Return True if the suffix is one that ``load_exported`` takes."""
    return Path(name_or_path).suffix.lower() in _SUFFIXES


def load_exported(
    path: str | Path,
    *,
    precision: Precision = "float32",
    threads: int | None = None,
    streams: int = 1,
    keep: Path | None = None,
    device: str = "auto",
) -> ExportedModel:
    """Load a file that ``zoedepth export`` wrote. ``load_model`` does it too; only here threads can be chosen.

    Such files hold no code: both runtimes read a graph of operations that they know. A graph whose constants ask for
    far more memory than its file has, or that has loops, is refused before it is run. One that multiplies the size of
    the photo is not: run files of strangers where the memory is limited (``ulimit -v``).

    Args:
        path: .onnx file, or OpenVINO's .xml with its .bin beside it.
        precision: number type that OpenVINO computes in; ONNX Runtime always uses the file's. Where the processor has
            no bfloat16, it is float32, and the model's ``precision`` says so.
        threads: processor threads of each forward; None: as many as torch uses or, where it is not imported, would.
        streams: number of forwards that will run at the same time (OpenVINO).
        keep: folder in which OpenVINO's compiled graph is kept for the next start, as large as the weights for each of
            up to three shapes of pixels. It belongs to this file, this version of OpenVINO and this machine alone;
            a graph of another file or version is compiled again.
        device: where an ONNX file runs: "cpu", else on CUDA where ONNX Runtime's package for GPUs is installed, as with
            "auto". OpenVINO files run on the CPU.

    Raises:
        InputError: there is no such file, it is of another kind, ``zoedepth export`` did not make it, or the precision
            is float16, which models of torch have on a GPU.
        MissingExtraError: the runtime is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    if precision == "float16":
        raise InputError(f"float16 is for models of torch on a GPU: load {path} in float32 or bfloat16")
    threads = threads or thread_count()
    if path.suffix.lower() == ".onnx":
        return OnnxModel(path, threads=threads, device=device)
    if path.suffix.lower() == ".xml":
        return OpenVinoModel(path, precision=precision, threads=threads, streams=streams, keep=keep)
    raise InputError(f"{path} is not an exported model that can run here: give a .onnx or .xml file")


def _read_metadata(metadata: str | None, path: Path) -> tuple[AnyModelConfig, Provenance]:
    if metadata is None:
        raise InputError(f"{path} holds no configuration: it was not made by zoedepth export. Use zoedepth export")
    values = parse_json(metadata, f"the metadata in {path}")
    if "config" not in values:
        raise InputError(f"the metadata in {path} holds no 'config': it was not made by zoedepth export")
    about = {name: values[name] for name in ("licence", "trained_on") if isinstance(values.get(name), str)}
    try:
        return model_config_from_dict(values["config"]), from_texts(about)
    except InputError as error:
        raise InputError(f"the configuration in {path} makes no model: {str(error)[:2000]}") from error
