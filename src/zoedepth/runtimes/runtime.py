"""The runtimes: a library, the numbers that it computes in, and the device. The rows of ``zoedepth benchmark``."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from zoedepth.forward.answer import Precision
from zoedepth.runtimes.machine import Machine
from zoedepth.weights.exported import ExportedModel, load_exported
from zoedepth.weights.load import load_network
from zoedepth.weights.openvino_processor import adds_8_bits_exactly, has_bfloat16

if TYPE_CHECKING:
    from zoedepth.model.interface import DepthModel

Library = Literal["torch", "ONNX Runtime", "OpenVINO"]
Numbers = Literal["float32", "bfloat16", "float16", "int8"]

_SUFFIXES: dict[Library, str] = {"ONNX Runtime": ".onnx", "OpenVINO": ".xml"}
_NEEDS: dict[Library, tuple[tuple[str, ...], str]] = {
    "torch": ((), ""),
    "ONNX Runtime": (("onnxruntime", "onnx"), "onnx"),
    "OpenVINO": (("openvino", "onnx"), "openvino"),
}
"""Library → modules that exporting for it and running it take, and the extra that has them."""


@dataclass(frozen=True)
class Runtime:
    """A way to compute a model."""

    library: Library
    numbers: Numbers
    on_gpu: bool = False

    @property
    def name(self) -> str:
        """The name of the row: "OpenVINO, int8"; "torch, float16, GPU"."""
        return f"{self.library}, {self.numbers}{', GPU' if self.on_gpu else ''}"

    @property
    def suffix(self) -> str | None:
        """The suffix of its exported files; None for torch, which runs the weights as they are."""
        return _SUFFIXES.get(self.library)

    @property
    def precision(self) -> Precision:
        """The precision as ``Predictor`` and ``load_exported`` take it: that of the file, for one in 8 bits."""
        return "float32" if self.numbers == "int8" else self.numbers

    def missing(self, machine: Machine, *, packaged: bool = False) -> str:
        """Return why it cannot run here; empty where it can.

        Args:
            machine: this machine.
            packaged: the package has the model's graph, so that nothing is exported for ONNX Runtime.
        """
        if self.on_gpu and machine.accelerator is None:
            return "no GPU here"
        modules, extra = _NEEDS[self.library]
        if self.numbers == "int8":
            modules = (*modules, "nncf")
        if packaged and self.library == "ONNX Runtime":
            modules = ("onnxruntime",)
        if any(map(_absent, modules)):
            return f"not installed: pip install 'zoedepth[{extra}]'"
        if self.library == "OpenVINO" and self.numbers == "bfloat16" and not has_bfloat16():
            return "this processor has no bfloat16, and OpenVINO would compute in float32"
        if self.numbers == "int8" and not adds_8_bits_exactly():
            return "this processor cuts off sums of 8 bits (no VNNI), and OpenVINO would compute in float32"
        return ""

    def load(
        self, model: Path, *, compat: Sequence[str] = (), streams: int = 1, keep: Path | None = None
    ) -> "DepthModel | ExportedModel":
        """Load a model for it.

        Args:
            model: the weights for torch; for the others, the exported file.
            compat: see ``load_model``; an exported file has its behaviour built in.
            streams: number of forwards that will run at the same time.
            keep: folder for compiled graphs, see ``load_exported``.

        Raises:
            InputError: it cannot be loaded, see ``load_model``.
        """
        if self.suffix is None:
            return load_network(model, compat=compat)
        precision: Precision = "bfloat16" if self.numbers == "bfloat16" else "float32"
        # None of these rows is of a GPU, even where ONNX Runtime could take one.
        return load_exported(model, precision=precision, streams=streams, keep=keep, device="cpu")


def _absent(module: str) -> bool:
    return find_spec(module) is None


BASE = Runtime("torch", "float32")
"""The runtime that the others are compared with."""

RUNTIMES = {
    runtime.name: runtime
    for runtime in (
        BASE,
        Runtime("torch", "bfloat16"),
        Runtime("ONNX Runtime", "float32"),
        Runtime("OpenVINO", "float32"),
        Runtime("OpenVINO", "bfloat16"),
        Runtime("OpenVINO", "int8"),
        Runtime("torch", "float32", on_gpu=True),
        Runtime("torch", "bfloat16", on_gpu=True),
        Runtime("torch", "float16", on_gpu=True),
    )
}
"""Name of the row → runtime, in the order of the table."""
