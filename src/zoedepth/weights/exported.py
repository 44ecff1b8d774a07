"""Running an exported file behind the interface of every model, so that ``Predictor`` takes it like any other."""

import json
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from zoedepth.config import AnyModelConfig, model_config_from_dict
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.model.interface import DepthModel, DepthOutput
from zoedepth.weights.layouts.files import parse_json
from zoedepth.weights.openvino_graph import specialized
from zoedepth.weights.tensors import DOMAIN, INPUT, STD, Exported

METADATA = "zoedepth"
"""Key of the JSON in the file's metadata: config, preprocessing, version."""
Precision = Literal["float32", "bfloat16"]


class ExportedModel(DepthModel):
    """A file of another runtime. It runs on the CPU, cannot be trained, and has no relative depth."""

    def __init__(self, metadata: str | None, path: Path) -> None:
        super().__init__()
        self.config = _config(metadata, path)
        self.eval()

    @property
    def device(self) -> torch.device:
        """Pixels and depth are on the CPU, wherever the runtime computes."""
        return torch.device("cpu")

    @abstractmethod
    def run(self, inputs: Mapping[str, np.ndarray], *, std: bool) -> Mapping[str, np.ndarray]:
        """Outputs by name, of inputs by name; without the standard deviation, if there is one, unless it is wanted."""

    def forward(
        self,
        pixels: Float[Tensor, "batch 3 height width"],
        *,
        domain: Int[Tensor, " batch"] | None = None,
        return_std: bool = False,
        return_bins: bool = False,
    ) -> DepthOutput:
        """Depth of a batch, as ``DepthModel.forward``; what is not asked for comes at no cost.

        Raises:
            InputError: wrong shape or size, or bins are asked for, which no exported file gives.
        """
        if return_bins:
            raise InputError("an exported model gives no bins: use the model it was made from")
        self.check(pixels, domain)
        inputs = {INPUT: pixels.float().contiguous().numpy()}
        if len(self.config.domains) > 1:
            inputs[DOMAIN] = np.full(len(pixels), -1) if domain is None else domain.long().numpy()
        found = {name: torch.from_numpy(x) for name, x in self.run(inputs, std=return_std).items()}
        said = Exported(found["predicted_depth"], found.get(STD), found.get("domain_logits"))
        taken = torch.zeros(len(pixels), dtype=torch.long)
        if said.domain_logits is not None:
            taken = said.domain_logits.argmax(dim=1) if domain is None else domain.long()
        std = None if said.std is None else said.std[:, None]
        return DepthOutput(said.predicted_depth[:, None], None, taken, said.domain_logits, std, None, None)


class OnnxModel(ExportedModel):
    """An ONNX file in ONNX Runtime: CUDA where its GPU package is installed (not run), else the CPU."""

    def __init__(self, path: Path, *, threads: int) -> None:
        try:
            import onnxruntime
        except ModuleNotFoundError as error:
            raise MissingExtraError("onnx", "running an ONNX file") from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3  # errors: it warns of the default of the second input
        wanted = ("CUDAExecutionProvider", "CPUExecutionProvider")
        providers = [name for name in wanted if name in onnxruntime.get_available_providers()]
        try:
            self.session = onnxruntime.InferenceSession(str(path), options, providers=providers)
        except Exception as error:  # its errors share no class
            raise InputError(f"{path} cannot be read as ONNX: {str(error)[:300]}") from error
        self.names = [output.name for output in self.session.get_outputs()]
        super().__init__(self.session.get_modelmeta().custom_metadata_map.get(METADATA), path)

    def run(self, inputs: Mapping[str, np.ndarray], *, std: bool) -> Mapping[str, np.ndarray]:
        """Outputs by name, of inputs by name; see ``ExportedModel``."""
        names = [name for name in self.names if std or name != STD]
        found: Any = self.session.run(names, dict(inputs))
        return dict(zip(names, found, strict=True))


class OpenVinoModel(ExportedModel):
    """An OpenVINO file, compiled for this processor.

    It is compiled for the first shape of pixels that comes, which is faster and needs less memory than a graph of any
    shape; all other shapes share one of those, compiled when the first of them comes. So it is with the standard
    deviation and without it.
    """

    def __init__(self, path: Path, *, precision: Precision, threads: int, streams: int) -> None:
        try:
            import openvino
        except ModuleNotFoundError as error:
            raise MissingExtraError("openvino", "running an OpenVINO file") from error
        self.path = path
        self.core = openvino.Core()
        self.properties = {
            "INFERENCE_PRECISION_HINT": {"float32": "f32", "bfloat16": "bf16"}[precision],
            "INFERENCE_NUM_THREADS": threads * streams,
            "NUM_STREAMS": streams,
        }
        try:
            self.graph = self.core.read_model(path)
            metadata = self.graph.get_rt_info(METADATA).astype(str) if self.graph.has_rt_info(METADATA) else None
        except Exception as error:  # a RuntimeError of C++, mostly
            raise InputError(f"{path} cannot be read as OpenVINO: {str(error)[:300]}") from error
        self.lock = Lock()
        self.first_shape: tuple[int, ...] | None = None
        self.compiled: dict[tuple[bool, bool], Any] = {}
        """By whether they take the first shape only, and whether they give the standard deviation."""
        super().__init__(metadata, path)

    def run(self, inputs: Mapping[str, np.ndarray], *, std: bool) -> Mapping[str, np.ndarray]:
        """Outputs by name, of inputs by name; see ``ExportedModel``. A request of its own: threads may share it."""
        compiled = self._compiled_for(inputs[INPUT].shape, std=std)
        results: Any = compiled.create_infer_request().infer(dict(inputs))
        return {output.get_any_name(): np.array(results[output]) for output in compiled.outputs}

    def _compiled_for(self, shape: tuple[int, ...], *, std: bool) -> Any:
        with self.lock:
            self.first_shape = self.first_shape or shape
            key = (shape == self.first_shape, std)
            if key not in self.compiled:
                try:
                    graph = specialized(self.graph, shape=shape if key[0] else None, without=() if std else (STD,))
                    self.compiled[key] = self.core.compile_model(graph, "CPU", self.properties)
                except Exception as error:  # a RuntimeError of C++, mostly
                    raise InputError(f"{self.path} cannot be compiled: {str(error)[:300]}") from error
            return self.compiled[key]


_SUFFIXES = (".onnx", ".xml")


def is_exported(name_or_path: str | Path) -> bool:
    """Whether ``load_exported`` takes it, by its suffix."""
    return Path(name_or_path).suffix.lower() in _SUFFIXES


def load_exported(
    path: str | Path, *, precision: Precision = "float32", threads: int | None = None, streams: int = 1
) -> ExportedModel:
    """A file that ``zoedepth export`` wrote, for ``Predictor``.

    Files hold no code: both runtimes read a graph of their own known operations.

    Args:
        path: .onnx, or OpenVINO's .xml with its .bin beside it.
        precision: that OpenVINO computes in; ONNX Runtime always computes in the file's.
        threads: of each forward; None: as many as torch uses.
        streams: forwards that will run at the same time.

    Raises:
        InputError: no such file, not one of these, or not made by ``zoedepth export``.
        MissingExtraError: the runtime is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    threads = threads or torch.get_num_threads()
    if path.suffix.lower() == ".onnx":
        return OnnxModel(path, threads=threads)
    if path.suffix.lower() == ".xml":
        return OpenVinoModel(path, precision=precision, threads=threads, streams=streams)
    raise InputError(f"{path} is not an exported model that runs here: give a .onnx or .xml file")


def _config(metadata: str | None, path: Path) -> AnyModelConfig:
    if metadata is None:
        raise InputError(f"{path} does not say its configuration: it was not made by zoedepth export")
    try:
        return model_config_from_dict(parse_json(metadata)["config"])
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise InputError(f"the configuration in {path} cannot be read: {error}") from error
