"""Maps in OpenEXR files, whose parts and channels are counted before the library unpacks them."""

from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.images import MAX_PIXELS, check_expansion
from zoedepth.stored.files import Map, cause, check_exists, check_map

# How channels of depth are called, without regard to case; V is Blender's name for one value. Beside them in one layer:
# channels that make a vector of Z, a texture's place or a colour of V. Parts of names of layers that are not depth.
_DEPTH, _SIBLINGS = {"z", "v", "depth"}, {"x", "y", "u", "s"}
_OTHERS = (
    "mist", "index", "count", "mask", "denoising", "disparity", "inverse", "invdepth", "normal", "albedo", "confidence",
    "occlusion",
)  # fmt: skip
_OF_UNREAL = ("worlddepth", "scenedepth")
_MOST_NAMED = 12


def read_exr(path: Path) -> Map:
    """Read the depth of an OpenEXR file: its only channel, or the one that is named so.

    Of several channels in all parts it is the one whose last part is Z, V or Depth, as Blender's ``ViewLayer.Depth.Z``.
    Normals, mist and the like, whose last part may be Z, are none, also where there is nothing else in the file; V is
    none in a layer that is not called depth. R, G and B that are equal are one channel. Float32, or the whole numbers
    of a channel of them, whose unit somebody else must say.

    Raises:
        InputError: the file is missing, damaged or too large; it has several channels, and which one is depth cannot be
            told (they are listed); or it covers a part of the picture only.
        MissingExtraError: OpenEXR is not installed.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingExtraError("exr", f"reading {path.name}") from error
    check_exists(path)
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            _check_exr([part.header for part in file.parts], path.stat().st_size)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {_name(part.name(), name): (part.header, np.asarray(channel.pixels))
                        for part in file.parts for name, channel in part.channels.items()}  # fmt: skip
            header, values = channels[_choose({name: values for name, (_, values) in channels.items()})]
            _check_window(header)
        check_map(values.shape, values.dtype)
    except Exception as error:  # the library raises RuntimeError and others for damage of any kind
        raise InputError(f"{path} is not a readable OpenEXR file of depth ({cause(path, error)})") from error
    return values if values.dtype.kind == "u" else values.astype(np.float32, copy=False)


_COLOURS = ("r", "g", "b", "red", "green", "blue")


def _name(part: str, channel: str) -> str:
    return channel if not part or channel.startswith(part) else f"{part}.{channel}"


def _choose(channels: dict[str, Map]) -> str:
    """Return the name of the channel of depth."""
    opaque = [name for name in channels if name.lower() not in ("a", "alpha")] or list(channels)
    if len(opaque) == 1 and not _is_another(opaque[0]):
        return _in_metres(opaque[0])
    found = [name for name in channels if _may_be_depth(name, channels)]
    named = [name for name in found if "depth" in name.lower()]
    if len(named or found) == 1:
        return _in_metres((named or found)[0])
    grey = len(opaque) > 1 and all(name.lower() in _COLOURS for name in opaque)
    if not found and grey and all(np.array_equal(channels[opaque[0]], channels[name]) for name in opaque[1:]):
        return opaque[0]
    more = f" and {len(channels) - _MOST_NAMED} more" if len(channels) > _MOST_NAMED else ""
    raise ValueError(
        f"which of its channels is depth cannot be told: {', '.join(sorted(channels)[:_MOST_NAMED])}{more}. Save depth "
        "alone, as the only channel or as Z"
    )


def _may_be_depth(name: str, channels: dict[str, Map]) -> bool:
    layer, _, last = name.lower().rpartition(".")
    beside = {other.lower().rpartition(".")[2] for other in channels if other.lower().rpartition(".")[0] == layer}
    if _is_another(name) or beside & _SIBLINGS:
        return False
    return last in _DEPTH and (last != "v" or not layer or "depth" in layer)  # V: of any layer, as roughness


def _is_another(name: str) -> bool:
    """Return True where the name of a channel, with its layer, says that it is something else than depth in metres."""
    parts = name.lower().split(".")
    return "ao" in parts or any(word in name.lower() for word in _OTHERS)


def _in_metres(name: str) -> str:
    """Return the name of a channel, unless it is one that a program is known to write in another unit."""
    if any(word in name.lower() for word in _OF_UNREAL):
        raise ValueError(f"its channel {name} is Unreal's depth, in centimetres: divide it by 100, and save it as Z")
    return name


def _check_window(header: dict[str, Any]) -> None:
    """Refuse a map of a part of the picture: it would lie elsewhere in the photo."""
    data, display = ([tuple(map(int, corner)) for corner in header[f"{kind}Window"]] for kind in ("data", "display"))
    if data != display:
        raise ValueError(
            f"its pixels cover {data[0]} to {data[1]}, and the picture is {display[0]} to {display[1]}: save all of it"
        )


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
