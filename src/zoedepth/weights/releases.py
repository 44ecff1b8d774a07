"""Published weights by name: what they are for, where they come from, and where they are kept. No torch here."""

import os
from dataclasses import dataclass
from pathlib import Path

from zoedepth.download import cache_home

ASSETS = Path(__file__).parents[1] / "assets"

_ZOEDEPTH = "https://github.com/isl-org/ZoeDepth/releases/download/v1.0"
_MIDAS = "https://github.com/isl-org/MiDaS/releases/download/v3_1"


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
    url: str | None = None
    """Address that the file is downloaded from; None: it is in the package."""
    hub_id: str | None = None
    """Hugging Face id of the same model."""

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
    ),
    "zoed-m12-n": Release(
        "indoor (NYU Depth v2, 10 m)",
        "ZoeD_M12_N.pt",
        "1.4 GB",
        "MIT",
        f"{_ZOEDEPTH}/ZoeD_M12_N.pt",
        "Intel/zoedepth-nyu",
    ),
    "zoed-m12-k": Release(
        "driving (KITTI, 80 m)",
        "ZoeD_M12_K.pt",
        "1.4 GB",
        "MIT",
        f"{_ZOEDEPTH}/ZoeD_M12_K.pt",
        "Intel/zoedepth-kitti",
    ),
    "zoed-m12-nk": Release(
        "indoor and driving, with a router (NYU and KITTI)",
        "ZoeD_M12_NK.pt",
        "1.4 GB",
        "MIT",
        f"{_ZOEDEPTH}/ZoeD_M12_NK.pt",
        "Intel/zoedepth-nyu-kitti",
    ),
    "dpt-beit-large-384": Release(
        "relative depth only (MiDaS v3.1): what to fine-tune from",
        "dpt_beit_large_384.pt",
        "1.4 GB",
        "MIT",
        f"{_MIDAS}/dpt_beit_large_384.pt",
    ),
}
"""Name for ``load_model`` → release."""


def download_folder() -> Path:
    """Return the folder where torch.hub keeps checkpoints: files that the original downloaded are found there."""
    given = os.environ.get("TORCH_HOME")
    home = Path(os.path.expanduser(given)) if given else cache_home() / "torch"
    return home / "hub" / "checkpoints"
