"""The machine that computes, and the versions of the libraries that compute: what speed depends on beside the model."""

import platform
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from zoedepth import __version__
from zoedepth.threads import cpu_count, has_accelerator
from zoedepth.weights.fingerprint import fingerprint

CPUINFO = Path("/proc/cpuinfo")

LIBRARIES = {
    "torch": ("torch",),
    "timm": ("timm",),
    "onnx": ("onnx",),
    "onnxruntime": ("onnxruntime", "onnxruntime-gpu"),
    "openvino": ("openvino",),
    "nncf": ("nncf",),
}
"""Library → names of the distributions that may have it."""

_KIND = ("vendor_id", "cpu family", "model", "stepping", "flags", "CPU implementer", "CPU part", "Features")
"""Lines of Linux's /proc/cpuinfo that tell one kind of processor from another. Virtual ones share a name."""


@dataclass(frozen=True)
class Machine:
    """A machine, as far as the speed of a model depends on it."""

    processor: str
    """Name of the processor, for people."""
    instructions: str
    """Hash of its kind and of its instructions; empty where the system does not tell them."""
    cores: int
    """Number of cores that this process may use."""
    accelerator: str | None
    """Name of the GPU that torch would use; None where there is none, or it is not wanted."""

    @property
    def fingerprint(self) -> str:
        """A short hash that changes with all of it."""
        return fingerprint(asdict(self))

    def __str__(self) -> str:
        cores = "1 core" if self.cores == 1 else f"{self.cores} cores"
        return ", ".join(filter(None, (self.processor, cores, self.accelerator)))


def this_machine(device: str = "auto") -> Machine:
    """Return this machine; torch is imported only where there are signs of a GPU.

    Args:
        device: "cpu" looks for no GPU.
    """
    about = _cpuinfo()
    name = about.get("model name") or _processor_name() or platform.machine() or "unknown processor"
    kind = {key: about[key] for key in _KIND if key in about}
    return Machine(
        name, fingerprint(kind) if kind else "", cpu_count(), None if device == "cpu" else _accelerator_name()
    )


def versions() -> dict[str, str | None]:
    """Return the versions of this package and of ``LIBRARIES``; None for one that is not installed."""
    return {"zoedepth": __version__, **{name: _version(names) for name, names in LIBRARIES.items()}}


def _version(distributions: tuple[str, ...]) -> str | None:
    for name in distributions:
        with suppress(PackageNotFoundError):
            return version(name)
    return None


def _cpuinfo() -> Mapping[str, str]:
    """Return what Linux says of the first processor; nothing elsewhere."""
    try:
        text = CPUINFO.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return {}
    pairs = (line.partition(":") for line in text.partition("\n\n")[0].splitlines())
    return {key.strip(): value.strip() for key, _, value in pairs}


def _processor_name() -> str:
    if sys.platform == "darwin":
        with suppress(OSError, subprocess.SubprocessError):
            command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
            return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    return platform.processor()


def _accelerator_name() -> str | None:
    if not has_accelerator():
        return None
    import torch

    device = torch.accelerator.current_accelerator() if torch.accelerator.is_available() else None
    if device is None:
        return None
    return torch.cuda.get_device_name() if device.type == "cuda" else device.type
