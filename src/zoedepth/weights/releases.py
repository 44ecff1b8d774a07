"""Published weights by name: what they are for, where they come from, and where they are kept. No torch here."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from zoedepth.download import cache_home
from zoedepth.provenance import Provenance

ASSETS = Path(__file__).parents[1] / "assets"

_ZOEDEPTH = "https://github.com/isl-org/ZoeDepth/releases/download/v1.0"
_MIDAS = "https://github.com/isl-org/MiDaS/releases/download/v3_1"
_M12 = "relative depth of 12 data sets (MiDaS v3.1)"


def _measured(rel: float, rmse: float, log10: float, delta1: float, delta2: float, delta3: float) -> dict[str, float]:
    return {"rel": rel, "rmse": rmse, "log10": log10, "delta1": delta1, "delta2": delta2, "delta3": delta3}


@dataclass(frozen=True)
class Release:
    """Weights that somebody published, or that are in the package."""

    what: str
    """Purpose of the model, in one line."""
    file: str
    """File name."""
    size: str
    """Approximate size of the file."""
    licence: str
    """Licence of the weights, as their publisher states it."""
    trained_on: str
    """Training data, with its terms where they bind the weights."""
    url: str | None = None
    """Address that the file is downloaded from; None: it is in the package."""
    hub_id: str | None = None
    """Hugging Face id of the same weights."""
    alike_on_hub: bool = True
    """False if the files at the Hub say another size of photos than the model was trained with, and so give another
    depth."""
    graph: str | None = None
    """File name of its graph in ONNX, beside the weights and without any, for models in the package."""
    measured: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Numbers that were measured here, see ``Provenance.measured`` (docs/results.md)."""

    @property
    def provenance(self) -> Provenance:
        """Return licence, training data and measured numbers of the weights."""
        return Provenance(self.licence, self.trained_on, self.measured)

    @property
    def path(self) -> Path:
        """Return where the file is, or will be once it is downloaded."""
        return ASSETS / self.file if self.url is None else download_folder() / self.file

    @property
    def present(self) -> bool:
        """Return True if the file is on this machine."""
        return self.path.is_file()


RELEASES: dict[str, Release] = {
    "zoed-lite": Release(
        "indoor and outdoor, small: the model in the package",
        "zoed-lite.safetensors",
        "10.6 MB",
        "non-commercial research",
        "NYU Depth v2 (795 pairs, for research), KITTI (110 pairs, CC BY-NC-SA 3.0), 4,000 rendered scenes, with 67 of "
        "relative depth",
        graph="zoed-lite.onnx",
        measured={
            "NYU Depth v2, 654 test pairs": _measured(0.162, 0.545, 0.067, 0.776, 0.949, 0.987),
            "KITTI 2015, 38 pairs": _measured(0.092, 3.898, 0.041, 0.900, 0.983, 0.996),
            "KITTI raw, one drive, 26 pairs": _measured(0.172, 5.220, 0.079, 0.755, 0.928, 0.962),
            "7-Scenes, red kitchen, 40 pairs": _measured(0.269, 0.518, 0.100, 0.560, 0.878, 0.981),
            "Replica, one flat, 41 pairs": _measured(0.253, 0.603, 0.110, 0.573, 0.829, 0.929),
        },
    ),
    "zoed-m12-n": Release(
        "indoor (NYU Depth v2, 10 m)",
        "ZoeD_M12_N.pt",
        "1.4 GB",
        "MIT",
        f"NYU Depth v2 in metres; before that: {_M12}",
        f"{_ZOEDEPTH}/ZoeD_M12_N.pt",
        "Intel/zoedepth-nyu",
    ),
    "zoed-m12-k": Release(
        "driving (KITTI, 80 m)",
        "ZoeD_M12_K.pt",
        "1.4 GB",
        "MIT",
        f"KITTI in metres; before that: {_M12}",
        f"{_ZOEDEPTH}/ZoeD_M12_K.pt",
        "Intel/zoedepth-kitti",
        alike_on_hub=False,  # its processor may be transformers' default, 384x512, as in the two others
    ),
    "zoed-m12-nk": Release(
        "indoor and driving, with a router (NYU and KITTI)",
        "ZoeD_M12_NK.pt",
        "1.4 GB",
        "MIT",
        f"NYU Depth v2 and KITTI in metres; before that: {_M12}",
        f"{_ZOEDEPTH}/ZoeD_M12_NK.pt",
        "Intel/zoedepth-nyu-kitti",
    ),
    "dpt-beit-large-384": Release(
        "relative depth only (MiDaS v3.1): what recipes of training start from",
        "dpt_beit_large_384.pt",
        "1.4 GB",
        "MIT",
        _M12,
        f"{_MIDAS}/dpt_beit_large_384.pt",
    ),
}
"""Name for ``load_model`` → release."""


def download_folder() -> Path:
    """Return the folder where torch.hub keeps checkpoints: files that the original downloaded are found there."""
    given = os.environ.get("TORCH_HOME")
    home = Path(os.path.expanduser(given)) if given else cache_home() / "torch"
    return home / "hub" / "checkpoints"
