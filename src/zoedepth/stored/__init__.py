"""Depth maps, masks and small texts as files hold them: the only place in the package that reads them.

Files may come from anyone. A reader never runs what a file holds, and looks at the size that a file claims before it
unpacks anything: no small file can fill the memory. Everything that is wrong with a file ends in an ``InputError``
that names it.
"""

from zoedepth.stored.arrays import read_npy, read_npz, read_pfm, read_pgm
from zoedepth.stored.exr import read_exr
from zoedepth.stored.files import BoundedFile, Map, Memory
from zoedepth.stored.hdf5 import read_hdf5
from zoedepth.stored.maps import (
    DEPTH_SUFFIXES,
    SCALE_KEY,
    StoredMap,
    declared_scale,
    read_depth,
    read_mask,
    read_png,
    read_png16,
    read_png_with_text,
    read_stored,
    to_metres,
)
from zoedepth.stored.texts import (
    MAX_NESTING,
    MAX_TEXT,
    parse_json,
    read_json,
    read_numbers,
    read_text,
    readable,
    to_json,
    unreadable,
)

__all__ = [
    "DEPTH_SUFFIXES",
    "MAX_NESTING",
    "MAX_TEXT",
    "SCALE_KEY",
    "BoundedFile",
    "Map",
    "Memory",
    "StoredMap",
    "declared_scale",
    "parse_json",
    "read_depth",
    "read_exr",
    "read_hdf5",
    "read_json",
    "read_mask",
    "read_npy",
    "read_npz",
    "read_numbers",
    "read_pfm",
    "read_pgm",
    "read_png",
    "read_png16",
    "read_png_with_text",
    "read_stored",
    "read_text",
    "readable",
    "to_json",
    "to_metres",
    "unreadable",
]
