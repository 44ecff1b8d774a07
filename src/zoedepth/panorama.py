"""From a panorama, a photo of everything around the camera, to metres: models see it in parts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32

from zoedepth import colors
from zoedepth.claims import BinaryFile
from zoedepth.depth_map import DepthMap
from zoedepth.geometry.mesh import Mesh
from zoedepth.geometry.panorama import (
    FOV,
    build_panorama_mesh,
    check_panorama,
    cut_out,
    merge,
    panorama_normals,
    panorama_points,
    panorama_views,
    resized,
    sharp_height,
)
from zoedepth.images import DepthArray, ImageArray, read_image, read_photo_notes, read_stored_size, to_image
from zoedepth.outputs import Maps, Options, save_maps
from zoedepth.predict import Predictor

_TOLERATED = 1.2  # a panorama is reduced where its pixels are so many times finer than those of the views
_NARROWEST = 64  # pixels that a view is wide, at least


@dataclass(frozen=True, eq=False)
class PanoramaMap:
    """The distance of everything around the camera, at the panorama's size.

    A panorama is equirectangular: 360 degrees from left to right, 180 from top to bottom; see ``geometry.panorama``.
    """

    distance: DepthArray
    """Metres along the ray, for a panorama has no optical axis; finite and positive everywhere."""
    image: ImageArray
    """The panorama, RGB."""
    domain: str
    """Scene type whose head made the distances."""
    scales: Float[np.ndarray, " views"]
    """The factors by which the distances of the views were multiplied to agree."""
    disagreement: float
    """Mean difference between two views of one place after that, as a fraction of the distance: how far the shape of a
    view is off, at least."""
    depth_range: tuple[float, float] = (0.0, math.inf)
    """Metres: distances at or below the first or beyond the second are none of the model's."""
    focal_correction: float = 1.0
    """The factor by which the depths of the views were multiplied because their focal length is not that of the
    training photos; 1 where they were not."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the panorama and of the distances."""
        return self.distance.shape[0], self.distance.shape[1]

    @cached_property
    def maps(self) -> Maps:
        """The arrays alone, for ``outputs``."""
        return Maps(depth=self.distance, image=self.image, depth_range=self.depth_range, panorama=True)

    @property
    def valid(self) -> Bool[np.ndarray, "height width"]:
        """True where the distance can be used: it is finite, within ``depth_range``, and no flying pixel."""
        valid = self.maps.valid
        assert valid is not None  # there is depth
        return valid

    @property
    def points(self) -> Float32[np.ndarray, "height width 3"]:
        """The point in space that each pixel sees, metres, from the camera: x to the right, y down, z to the middle."""
        return panorama_points(self.distance)

    @property
    def normals(self) -> Float32[np.ndarray, "height width 3"]:
        """The unit normal of the surface at each pixel, towards the camera, in the axes of ``points``."""
        return panorama_normals(np.where(self.valid, self.distance, np.float32(np.nan)))

    def mesh(self, *, max_triangles: int | None = Options.max_triangles) -> Mesh:
        """Return the surface all around, without a seam; see ``geometry.panorama.build_panorama_mesh``."""
        return build_panorama_mesh(self.distance, valid=self.valid, max_triangles=max_triangles)

    def preview(self, *, vmin: float | None = None, vmax: float | None = None, colormap: str = "magma_r") -> ImageArray:
        """Return the panorama beside its coloured distance with a bar in metres; see ``colors.preview``."""
        return colors.preview(self.image, self.distance, vmin=vmin, vmax=vmax, colormap=colormap)

    def save(
        self,
        path: str | Path,
        *,
        scale: float | None = None,
        max_triangles: int | None = Options.max_triangles,
        max_depth: float | None = None,
    ) -> None:
        """Write the distances in the format of the suffix, whole or not at all, as ``DepthMap.save`` does.

        Files of depth (.png, .npy, .npz, .exr, .tif, .pfm) hold the distance, along the ray. .glb and .usdz hold the
        surface all around with the panorama on it, .html a page for the browser that shows it, .ply and .pcd the points
        of the valid pixels with colours and normals.

        Args:
            path: where to write; missing folders are made.
            scale: PNG levels per metre. None is 1000 (millimetres), or 256 where the distance exceeds 65.535 m.
            max_triangles: triangles of a .glb, .usdz or .html, at most. None keeps all, two for each pixel.
            max_depth: metres beyond which a pixel makes no point and no surface, as for the sky; None keeps all.

        Warns:
            InputWarning: see ``DepthMap.save``.

        Raises:
            InputError: another suffix, or there is nothing to make points or a surface of.
            MissingExtraError: a library that the format needs is not installed.
        """
        save_maps(path, self.maps, Options(png_scale=scale, max_triangles=max_triangles, max_depth=max_depth))


def predict_panorama(predictor: Predictor, image: Any, *, domain: str | None = None) -> PanoramaMap:
    """Predict the distance of everything around the camera from a panorama.

    The model sees 22 overlapping views of 90 degrees; the scales of their distances are made to agree where they
    overlap, and the distances are blended (``geometry.panorama.merge``). All views take the same head. The camera of
    each view is known, so that depth is corrected by its focal length where the predictor does that for given cameras.

    Args:
        predictor: a predictor of a model for ordinary photos.
        image: the panorama, equirectangular, twice as wide as high; of any kind that ``Predictor`` takes.
        domain: scene type whose head to use; None takes the one that the model's router finds in the views together.

    Raises:
        InputError: the panorama cannot be read or is not twice as wide as high, or the domain is unknown.
    """
    is_file = isinstance(image, str | Path) or hasattr(image, "read")
    panorama = read_image(image, panorama=True) if is_file else to_image(image)
    check_panorama(panorama.shape)
    size = (panorama.shape[0], panorama.shape[1])
    # Views of the panorama's own sharpness: what is finer than they can be is reduced first.
    height = min(size[0], sharp_height(panorama_views()[0]))
    width = max(_NARROWEST, round(2 * height / math.pi * math.tan(math.radians(FOV / 2))))
    views = panorama_views((width * 3 // 4, width))
    reduced = panorama if size[0] <= _TOLERATED * height else resized(panorama, (height, 2 * height))
    pictures = [cut_out(reduced, view) for view in views]
    cameras = [view.camera for view in views]
    maps = predictor.batch(pictures, domain=domain, camera=cameras)
    chosen = domain or _common_domain(maps)
    others = [number for number, depth_map in enumerate(maps) if depth_map.domain != chosen]
    if others:
        again = predictor.batch(
            [pictures[number] for number in others], domain=chosen, camera=[cameras[number] for number in others]
        )
        for number, depth_map in zip(others, again, strict=True):
            maps[number] = depth_map
    merged = merge([depth_map.depth for depth_map in maps], views, (height, 2 * height))
    return PanoramaMap(
        resized(merged.distance, size),
        panorama,
        chosen,
        merged.scales,
        merged.disagreement,
        (min(depth_map.depth_range[0] for depth_map in maps), math.inf),
        maps[0].focal_correction,  # all views have one lens and one head
    )


def is_sphere(source: str | Path | BinaryFile) -> bool:
    """Return True if a photo is a panorama of 360 x 180 degrees, by its XMP and its shape; a part of one is not.

    Raises:
        InputError: it is no picture; see ``images.read_image``.
    """
    short, long = sorted(read_stored_size(source))
    if long - 2 * short > 2 or 2 * short - long > 2 or not read_photo_notes(source).sphere:
        return False
    height, width = read_image(source, panorama=True).shape[:2]
    return abs(width - 2 * height) <= 2


def _common_domain(maps: Sequence[DepthMap]) -> str:
    """Return the scene type that the router finds in all views together."""
    names = maps[0].domain_probability
    return max(names, key=lambda name: sum(depth_map.domain_probability[name] for depth_map in maps))
