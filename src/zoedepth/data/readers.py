"""Files of depth, disparity and masks as arrays, exactly as stored: what a value means is the data set's business.

Every reader refuses a file that is damaged, or larger than a photo may be, with an ``InputError`` that names it.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float32, Shaped
from PIL import Image

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.images import MAX_PIXELS

Stored = Shaped[np.ndarray, "height width"]


def read_png(path: Path) -> Stored:
    """The stored values of a PNG of one channel of 8 or 16 bits."""
    return read_png_with_text(path)[0]


def read_png_with_text(path: Path) -> tuple[Stored, dict[str, str]]:
    """The stored values of a PNG of one channel of 8 or 16 bits, and its text chunks."""
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            mode, values = picture.mode, np.asarray(picture)
            text = {str(key): str(value) for key, value in picture.info.items() if isinstance(value, str)}
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path} is not a readable PNG ({error})") from error
    if values.ndim != 2 or mode in ("1", "P"):
        raise InputError(f"{path} must be a PNG of one channel of 8 or 16 bits; it is of mode {mode!r}")
    return values, text


def read_npy(path: Path) -> Stored:
    """The one map of a .npy file; a last axis of one is dropped. Pickled objects are refused."""
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path} is not a readable .npy file ({error})") from error
    if not isinstance(values, np.ndarray):
        raise InputError(f"{path} is an archive, not a .npy file")
    if values.ndim == 3 and values.shape[-1] == 1:
        values = values[..., 0]
    _check(path, values.shape, values.dtype)
    return np.array(values)


def read_pfm(path: Path) -> Float32[np.ndarray, "height width"]:
    """A portable float map of one channel. Its rows are stored from the bottom up; here the first is the top one."""
    try:
        with path.open("rb") as file:
            kind, size, scale = (file.readline(100).decode("ascii").strip() for _ in range(3))
            width, height = (int(side) for side in size.split())
            order = "<" if float(scale) < 0 else ">"
            if kind != "Pf" or width < 1 or height < 1:
                raise ValueError(f"it is a {kind!r} of {width} x {height}, not a 'Pf'")
            _check(path, (height, width), np.dtype(np.float32))
            stored = np.frombuffer(file.read(4 * width * height), f"{order}f4").reshape(height, width)
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a readable PFM of one channel ({error})") from error
    return stored[::-1].astype(np.float32)


def read_hdf5(path: Path, key: str) -> Stored:
    """The map under a key of an HDF5 file.

    Raises:
        MissingExtraError: h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("data", f"reading {path.name}") from error
    try:
        with h5py.File(path, "r") as file:
            values = file[key]
            if not isinstance(values, h5py.Dataset):
                raise KeyError(f"{key!r} is no array")
            _check(path, values.shape, values.dtype)
            return np.asarray(values)
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path} is not an HDF5 file with a map {key!r} ({error})") from error


def read_exr(path: Path) -> Float32[np.ndarray, "height width"]:
    """The one channel of an OpenEXR file, or the first of its colours where it has several.

    Raises:
        MissingExtraError: OpenEXR is not installed.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingExtraError("data", f"reading {path.name}") from error
    if not path.is_file():
        raise InputError(f"there is no {path}")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            names = sorted(channels, key=lambda name: ("ZYRGB".find(name) % 6, name))
            values = np.asarray(channels[names[0]].pixels)
    except Exception as error:  # the library raises RuntimeError and others for damage of any kind
        raise InputError(f"{path} is not a readable OpenEXR file ({error})") from error
    _check(path, values.shape, values.dtype)
    return values.astype(np.float32)


def read_numbers(path: Path) -> list[float]:
    """The numbers of a small text file, separated by commas or white space."""
    try:
        if path.stat().st_size > 1 << 16:
            raise ValueError("it is far too long")
        return [float(word) for word in path.read_text(encoding="utf-8").replace(",", " ").split()]
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a text file of numbers ({error})") from error


def _check(path: Path, shape: tuple[int, ...], dtype: np.dtype) -> None:
    if len(shape) != 2 or 0 in shape or dtype.kind not in "uif":
        raise InputError(f"{path} must hold one map (height, width) of numbers; it holds {dtype} {tuple(shape)}")
    if shape[0] * shape[1] > MAX_PIXELS:
        raise InputError(f"{path} is {shape[1]} x {shape[0]} pixels: more than {MAX_PIXELS}")
