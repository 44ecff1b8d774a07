"""Maps in HDF5 files, whose chunks are looked at before the library unpacks them."""

import zlib
from itertools import islice, product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.images import check_expansion
from zoedepth.stored.files import Map, cause, check_exists, check_map

_MOST_NAMED = 12
_MAX_CHUNKS = 1 << 15  # 180 megapixels in chunks of 74 x 74
_MAX_CHUNK = 1 << 24  # values
_MAX_LZF_BYTES = 1 << 27
_LZF_RATIO = 88  # three bytes stand for 264 at most


def read_hdf5(path: Path, key: str) -> Map:
    """Read the map under a key of an HDF5 file.

    Raises:
        InputError: there is no such map, or it is damaged, too large, or partly in other files.
        MissingExtraError: h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("data", f"reading {path.name}") from error
    check_exists(path)
    try:
        with h5py.File(path, "r") as file:
            if isinstance(file.get(key, getlink=True), h5py.ExternalLink):
                raise ValueError(f"{key!r} is in another file")
            if key not in file:
                raise ValueError(f"it has {', '.join(sorted(islice(file, _MOST_NAMED))) or 'nothing'}")
            found = file[key]
            if found.file.filename != file.filename:  # behind a soft link may be an external one
                raise ValueError(f"{key!r} is in another file")
            if not isinstance(found, h5py.Dataset):
                raise ValueError(f"{key!r} is not an array")
            check_map(found.shape, found.dtype)
            check_expansion(found.size * found.dtype.itemsize, path.stat().st_size)
            _check_chunks(found)
            return np.asarray(found)
    except Exception as error:  # h5py raises OSError, KeyError, RuntimeError and others on a damaged file
        raise InputError(f"{path} is not an HDF5 file with a map {key!r} ({cause(path, error)})") from error


def _check_chunks(dataset: Any) -> None:
    """Refuse an HDF5 array whose chunks unpack to more than they should, or that leads to other files.

    HDF5 allows a chunk larger than its map, chunks without number, filters upon filters, and unpacks a chunk to
    whatever size it turns out to have.
    """
    import h5py

    if dataset.is_virtual or dataset.external:
        raise ValueError("its values are in other files")
    if dataset.chunks is None:
        return
    if prod(dataset.chunks) > max(dataset.size, _MAX_CHUNK):
        raise ValueError(f"its chunks of {dataset.chunks} are larger than the map")
    places = [range(0, side, chunk) for side, chunk in zip(dataset.shape, dataset.chunks, strict=True)]
    if prod(map(len, places)) > _MAX_CHUNKS:
        raise ValueError(f"it has more than {_MAX_CHUNKS:,} chunks")
    plan = dataset.id.get_create_plist()
    filters = [plan.get_filter(number)[0] for number in range(plan.get_nfilters())]
    # These leave a chunk at its size, or make it smaller than its type by a known number of bits.
    bounded = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32, h5py.h5z.FILTER_SCALEOFFSET, h5py.h5z.FILTER_NBIT}
    packers = [code for code in filters if code not in bounded]
    if packers not in ([], [h5py.h5z.FILTER_DEFLATE], [h5py.h5z.FILTER_LZF]):
        raise ValueError(f"it is compressed by the filters {packers}; repack it with gzip: h5repack -f GZIP=4")
    limit = prod(dataset.chunks) * dataset.dtype.itemsize
    for place in product(*places) if packers else ():
        if not dataset.id.get_chunk_info_by_coord(place).size:  # nothing was written there
            continue
        skipped, packed = dataset.id.read_direct_chunk(place)
        if skipped >> filters.index(packers[0]) & 1:  # this chunk is not packed
            continue
        unpacker = zlib.decompressobj()
        if packers == [h5py.h5z.FILTER_LZF]:
            larger = len(packed) * _LZF_RATIO > _MAX_LZF_BYTES
        else:
            larger = unpacker.decompress(packed, limit + 64) and unpacker.unconsumed_tail
        if larger:
            raise ValueError(f"a chunk unpacks to more than its {limit:,} bytes")
