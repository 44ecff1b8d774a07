"""The interface of an output: it gets the maps of a photo, writes one file, and says what a reader must know."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from zoedepth.colors import colorize
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.jumps import flying_pixels
from zoedepth.geometry.panorama import flying_in_panorama
from zoedepth.geometry.points import known_depth
from zoedepth.images import DepthArray, ImageArray

ValidArray = Bool[np.ndarray, "_height _width"]


@dataclass(frozen=True, eq=False)
class Maps:
    """The arrays known of one photo, all of one (height, width). Any network's depth can be written as files.

    Raises:
        InputError: a map is not an array (height, width), or their sizes or that of the camera differ.
    """

    depth: DepthArray | None = None
    """Metres along the optical axis; of a panorama, along the ray."""
    std: DepthArray | None = None
    """Metres: standard deviation of the depth."""
    relative: DepthArray | None = None
    """Inverse depth up to an unknown scale and shift; near is large."""
    image: ImageArray | None = None
    """The photo, RGB."""
    camera: Camera | None = None
    """The camera at the size of the maps; a panorama has none."""
    depth_range: tuple[float, float] = (0.0, np.inf)
    """Metres: depth at or below the first, or beyond the second, is outside of what the depth can be."""
    panorama: bool = False
    """True for a photo of everything around, 360 x 180 degrees, as ``geometry.panorama`` has it."""

    def __post_init__(self) -> None:
        maps = {"depth": self.depth, "std": self.std, "relative": self.relative}
        known = {name: check_map(values, name) for name, values in maps.items() if values is not None}
        sizes = {name: values.shape for name, values in known.items()}
        if self.image is not None:
            sizes["image"] = self.image.shape[:2]
        if self.camera is not None:
            sizes["camera"] = tuple(self.camera.size)
        if len(set(sizes.values())) > 1:
            raise InputError(f"the maps and the camera of a photo must have one size (height, width), got {sizes}")
        if self.panorama and self.camera is not None:
            raise InputError("a panorama looks everywhere and has no camera: leave the camera out")

    @property
    def projection(self) -> str:
        """The way in which the photo shows the world: "perspective", or "equirectangular", which is a panorama's."""
        return "equirectangular" if self.panorama else "perspective"

    @property
    def depth_along(self) -> str:
        """The line along which the depth is measured: the "optical axis", or the "ray" of each pixel of a panorama."""
        return "ray" if self.panorama else "optical axis"

    @property
    def confidence(self) -> DepthArray | None:
        """1 / (1 + std / depth), in (0, 1]; None without depth or std."""
        return None if self.depth is None or self.std is None else self.depth / (self.depth + self.std)

    @cached_property
    def valid(self) -> ValidArray | None:
        """True where the depth can be used: it is finite, within ``depth_range``, and no flying pixel.

        Flying pixels hang in the air between a near thing and what is behind it (``geometry.jumps``); where neither a
        camera nor a panorama is known, they are not looked for. None without depth. Computed once.
        """
        if self.depth is None:
            return None
        low, high = self.depth_range
        valid = np.isfinite(self.depth) & (self.depth > low) & (self.depth <= high)
        if self.camera is not None:
            valid &= ~flying_pixels(self.depth, self.camera)
        elif self.panorama:
            valid &= ~flying_in_panorama(self.depth)
        return valid

    def up_to(self, metres: float | None) -> "Maps":
        """Return the maps with what is beyond so many metres not valid: it makes no points and no surface.

        None changes nothing. Depth itself stays.
        """
        if metres is None:
            return self
        low, high = self.depth_range
        return replace(self, depth_range=(low, min(high, metres)))


@dataclass(frozen=True)
class Options:
    """How to write the files, for all kinds of outputs together; each takes what concerns it.

    Raises:
        InputError: a value that no file can be written with.
    """

    png_scale: float | None = None
    """Levels per metre of a depth PNG. None: 1000 (millimetres), or 256 for depth beyond 65.535 m."""
    vmin: float | None = None
    """Depth of the preview's first colour in metres; None takes it from each photo."""
    vmax: float | None = None
    """Depth of the preview's last colour in metres; None takes it from each photo."""
    colormap: str = "magma_r"
    """Colours of the preview, see ``colors.colorize``."""
    max_triangles: int | None = 500_000
    """Triangles of a mesh, at most; None keeps all, one or two for each pixel."""
    max_depth: float | None = None
    """Metres beyond which a pixel is not ``valid``, and makes no point and no surface, as for the sky; None keeps all.
    Maps of depth keep theirs."""

    def __post_init__(self) -> None:
        if self.max_triangles is not None and self.max_triangles < 1:
            raise InputError(
                f"a mesh has at least 1 triangle (--max-triangles, max_triangles=), got {self.max_triangles}"
            )
        if self.max_depth is not None and not 0 < self.max_depth < np.inf:
            raise InputError(f"points end at a distance above 0 m (--max-depth, max_depth=), got {self.max_depth}")
        if self.png_scale is not None:
            check_png_scale(self.png_scale)
        colorize(np.ones((1, 1)), vmin=self.vmin, vmax=self.vmax, colormap=self.colormap)


@dataclass(frozen=True)
class Written:
    """The things worth saying about a file that was written."""

    facts: Mapping[str, object] = field(default_factory=dict)
    """Values for the sidecar, without which a program could not read the file right."""
    notes: tuple[str, ...] = ()
    """Sentences for the user about this photo, the same for each photo they hold for, so that they can be counted."""


@dataclass(frozen=True)
class Output:
    """A kind of file."""

    ending: str
    """The end of its file's name, e.g. "_depth.png" for photo_depth.png."""
    summary: str
    """The content of the file, for a line of help, e.g. "metres as a 16-bit PNG"."""
    write: Callable[[Path, Maps, Options], Written]
    """Write the file, whole or not at all (``images.atomic_path``)."""
    suffixes: tuple[str, ...] = ()
    """Suffixes (lower case) by which ``write_maps`` chooses this output."""
    maps: tuple[str, ...] = ("depth",)
    """Names of the maps it can be made of; one of them is enough."""


def check_map(values: np.ndarray, name: str = "depth") -> np.ndarray:
    """Return the map if it is an array (height, width).

    Raises:
        InputError: it is not.
    """
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.size == 0:
        found = getattr(values, "shape", type(values).__name__)
        raise InputError(f"{name} must be an array (height, width), got {found}")
    return values


def known_or_zero(depth: np.ndarray) -> np.ndarray:
    """Return metres in float32, in one piece of memory, with 0 where there is no depth: no finite number above 0."""
    with np.errstate(over="ignore"):  # float64 beyond float32 is as unknown as infinity
        depth = np.ascontiguousarray(depth, np.float32)
    known = known_depth(depth)
    return depth if known.all() else np.where(known, depth, np.float32(0))


def needed(maps: Maps, name: str) -> Any:
    """Return the map, the image or the camera called ``name``.

    Raises:
        InputError: there is none.
    """
    values = getattr(maps, name)
    if values is None:
        raise InputError(f"this kind of file needs {name!r}, which was not given: add it, or write another kind")
    return values


def check_png_scale(scale: float) -> None:
    """Refuse a scale that no depth PNG can have.

    Raises:
        InputError: it is not a positive number.
    """
    if not 0 < scale < float("inf"):
        raise InputError(
            f"the PNG scale (--png-scale, scale=) must be levels per metre, above 0, got {scale}: use 1000 or 256"
        )
