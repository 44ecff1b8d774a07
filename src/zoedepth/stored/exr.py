"""Maps in OpenEXR files, whose parts and channels are counted before the library unpacks them."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.images import MAX_PIXELS, check_expansion
from zoedepth.stored.files import check_exists, check_map


def read_exr(path: Path) -> Float32[np.ndarray, "height width"]:
    """Read the one channel of an OpenEXR file. Of several, it is the first of Z, Y, R, G, B, then of the alphabet.

    Raises:
        InputError: the file is missing, damaged or too large.
        MissingExtraError: OpenEXR is not installed.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingExtraError("data", f"reading {path.name}") from error
    check_exists(path)
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            _check_exr([part.header for part in file.parts], path.stat().st_size)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            names = sorted(channels, key=lambda name: ("ZYRGB".find(name) % 6, name))
            values = np.asarray(channels[names[0]].pixels)
        check_map(values.shape, values.dtype)
    except Exception as error:  # the library raises RuntimeError and others for damage of any kind
        raise InputError(f"{path} is not a readable OpenEXR file ({error})") from error
    return values.astype(np.float32, copy=False)


def _check_exr(headers: list[dict[str, Any]], n_bytes: int) -> None:
    """Refuse an OpenEXR file whose parts and channels, all of which the library unpacks, are too large together."""
    total = 0
    for header in headers:
        (left, top), (right, bottom) = (tuple(map(int, corner)) for corner in header["dataWindow"])
        kind = str(header.get("type", "")).rpartition(".")[2]
        if kind not in ("scanlineimage", "tiledimage"):
            raise ValueError(f"it is a {kind}, with any number of depths a pixel")
        total += (right - left + 1) * (bottom - top + 1) * max(1, len(header["channels"]))
    if total > MAX_PIXELS:
        raise ValueError(f"{total:,} values in all its channels are more than {MAX_PIXELS:,}")
    check_expansion(4 * total, n_bytes)
