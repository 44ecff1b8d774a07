"""Answers: the files of `zoedepth predict`, the same to the last byte, and what the page needs."""

import json
import os
import shutil
import struct
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zoedepth import __version__
from zoedepth.depth_map import DepthMap
from zoedepth.outputs import OUTPUTS, Options
from zoedepth.outputs import sidecar as sidecars
from zoedepth.serve.photos import Decoded
from zoedepth.serve.problems import Problem
from zoedepth.stored import to_json

MAPS, JSON = "maps", "json"
MAPS_TYPE = "application/vnd.zoedepth.maps"
NOTES = "zoedepth-notes"
"""Header with what is worth knowing about the file that is answered."""
DEFAULT = "depth"
"""Name of the format of the answer where the client says none."""

_MAGIC = b"ZOEDMAPS"
_ALIGNED = 8
_OUTPUT_TYPES = {
    "depth": "image/png",
    "exr": "image/x-exr",
    "npz": "application/x-npz",
    "ply": "application/x-ply",
    "glb": "model/gltf-binary",
    "usdz": "model/vnd.usdz+zip",
    "tiff": "image/tiff",
    "pfm": "image/x-portable-floatmap",
    "npy": "application/x-npy",
    "pcd": "application/x-pcd",
    "html": "text/html",
    "preview": "image/jpeg",
    "color": "image/png",
}
_ALIASES = {"depth": ("png",), "preview": ("jpg",), "tiff": ("tif",)}
_NEEDS = {"exr": "OpenEXR"}
_MEMORY = Path("/dev/shm")  # a file system in memory, on Linux


@dataclass(frozen=True)
class Format:
    """A format of answers."""

    name: str
    """Name, as in ``OUTPUTS``, "json" or "maps"."""
    media_type: str
    """Media type, for Accept and Content-Type."""
    ending: str
    """End of the name under which browsers keep it."""
    summary: str
    """The content, in a line."""
    aliases: tuple[str, ...] = ()
    """Other words for it in ``?format=``."""
    needs: str | None = None
    """Module that writes it, where the package can do without."""

    @property
    def available(self) -> bool:
        """True where all is installed that it needs."""
        return self.needs is None or find_spec(self.needs) is not None


FORMATS = {
    name: Format(
        name, media_type, OUTPUTS[name].ending, OUTPUTS[name].summary, _ALIASES.get(name, ()), _NEEDS.get(name)
    )
    for name, media_type in _OUTPUT_TYPES.items()
} | {
    JSON: Format(JSON, "application/json", ".json", "what is known about the depth: camera, domain, median"),
    MAPS: Format(MAPS, MAPS_TYPE, ".maps", "depth, std and valid as arrays, for programs without a library"),
}
"""Name → format. The first one of a media type is that which Accept means."""

NAMES = tuple(word for known in FORMATS.values() for word in (*known.aliases, known.name))
"""Words for a format in a request."""


def choose_format(word: str | None, accept: str | None) -> Format:
    """Return the format of the answer: that of ``?format=``, else the one that Accept prefers.

    Raises:
        Problem: none of those that Accept names can be given.
    """
    if word is not None:
        return next(known for known in FORMATS.values() if word in (known.name, *known.aliases))
    if not accept:
        return FORMATS[DEFAULT]
    for media_type in _by_preference(accept):
        if media_type in ("*/*", "image/*"):
            return FORMATS[DEFAULT]
        for known in FORMATS.values():
            if known.media_type == media_type or (
                media_type.endswith("/*") and known.media_type.startswith(media_type[:-1])
            ):
                return known
    known = ", ".join(sorted({each.media_type for each in FORMATS.values()}))
    raise Problem("not-acceptable", f"Accept names no format that can be given. There are {known}; or say ?format=.")


def about(result: DepthMap, photo: Decoded, *, model: str, facts: Mapping[str, object]) -> dict[str, object]:
    """Return what there is to say about a depth map: the sidecar of `zoedepth predict`, without names of files."""
    calibration = result.calibration
    origin: dict[str, object] = {
        "model": model,
        "input_size": result.size,
        "network_size": result.network_size,
        "domain": result.domain,
        "domain_probability": sidecars.rounded(result.domain_probability),
        "camera_note": result.camera_note,
        "focal_correction": result.focal_correction,
        "calibration": None if calibration is None else replace(calibration, readings=()).to_json(),
        "notes": list(photo.warnings),
    }
    told = sidecars.describe(result.maps, origin=origin, facts=facts, files={})
    del told["files"]
    return told | {"zoedepth": __version__}


class File(NamedTuple):
    """A file that is answered."""

    content: bytes
    notes: tuple[str, ...] = ()
    """Sentences about it, see ``outputs.output.Written``: without them a number in it may be taken for another."""


def encode(result: DepthMap, photo: Decoded, wanted: Format, options: Options, *, model: str) -> File:
    """Return a depth map as a file of the format.

    Raises:
        InputError: there is nothing to make points or a surface of.
        MissingExtraError: a library that the format needs is not installed.
    """
    if wanted.name == JSON:
        return File(dump(about(result, photo, model=model, facts={})))
    if wanted.name == MAPS:
        return File(_encode_maps(result, about(result, photo, model=model, facts={})))
    with tempfile.TemporaryDirectory(prefix=_draft_prefix(), dir=memory_folder()) as folder:
        path = Path(folder, f"photo{wanted.ending}")
        written = OUTPUTS[wanted.name].write(path, result.maps.up_to(options.max_depth), options)
        return File(path.read_bytes(), written.notes)


def remove_drafts(pid: int | None = None) -> None:
    """Remove the files that a process has begun to write, where it ends or has ended at once.

    They are of somebody's photo.

    Args:
        pid: number of the process, which has ended; None: this process.
    """
    for folder in Path(memory_folder() or tempfile.gettempdir()).glob(f"{_draft_prefix(pid)}*"):
        shutil.rmtree(folder, ignore_errors=True)


def _draft_prefix(pid: int | None = None) -> str:
    return f"zoedepth-{os.getpid() if pid is None else pid}-"


def dump(values: object) -> bytes:
    """Return values as JSON in UTF-8."""
    return to_json(values).encode()


def memory_folder() -> str | None:
    """Return a folder in memory; None where the system has none, for that of temporary files."""
    return str(_MEMORY) if _MEMORY.is_dir() and os.access(_MEMORY, os.W_OK) else None


def _encode_maps(result: DepthMap, told: dict[str, Any]) -> bytes:
    """Return the arrays with a header in JSON before them.

    ``ZOEDMAPS``, the length of the header as a little-endian number of 32 bits, and the header, padded with spaces to a
    multiple of 8 bytes. Its ``arrays`` has the type, the shape and the offset from the start of each array, row by row.
    """
    arrays = {"depth": result.depth.astype("<f4", copy=False), "std": result.std, "valid": result.valid.view(np.uint8)}
    known = {name: np.ascontiguousarray(values) for name, values in arrays.items() if values is not None}
    types = {"f": "float32", "u": "uint8"}

    def header(offsets: Sequence[int]) -> bytes:
        listed = {
            name: {"type": types[values.dtype.kind], "shape": values.shape, "offset": offset}
            for (name, values), offset in zip(known.items(), offsets, strict=True)
        }
        # The numbers are written as wide as they can be, so that the header's length does not depend on them.
        return json.dumps({**told, "arrays": listed}).encode()

    start = len(_MAGIC) + 4
    n_header = -(-(start + len(header([1 << 40] * len(known)))) // _ALIGNED) * _ALIGNED - start
    offsets, place = [], start + n_header
    for values in known.values():
        offsets.append(place)
        place += -(-values.nbytes // _ALIGNED) * _ALIGNED
    pieces = [_MAGIC, struct.pack("<I", n_header), header(offsets).ljust(n_header)]
    for values in known.values():
        pieces += [values.tobytes(), bytes(-values.nbytes % _ALIGNED)]
    return b"".join(pieces)


def _by_preference(accept: str) -> list[str]:
    """Return the media types of an Accept header, the most wanted first."""
    wanted: list[tuple[float, int, str]] = []
    for place, entry in enumerate(accept.split(",")[:50]):
        media_type, *parameters = (part.strip().lower() for part in entry.split(";"))
        weight = 1.0
        for parameter in parameters:
            name, _, value = parameter.partition("=")
            if name.strip() == "q":
                try:
                    weight = float(value)
                except ValueError:
                    weight = 0.0
        if weight > 0 and media_type:
            wanted.append((-weight, place, media_type))
    return [media_type for _, _, media_type in sorted(wanted)]
