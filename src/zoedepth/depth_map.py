"""The depth of one photo: metres, how sure they are, what can be measured in it, and the files it can be written as."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32

from zoedepth import colors
from zoedepth.calibration import Calibration, Distance, Form, Point, calibrate
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.mesh import Mesh, build_mesh
from zoedepth.geometry.normals import estimate_normals
from zoedepth.geometry.points import unproject
from zoedepth.images import DepthArray, ImageArray
from zoedepth.outputs import Maps, Options, save_maps


class DepthAt(NamedTuple):
    """The depth at one pixel."""

    depth: float
    """Metres along the optical axis."""
    std: float | None
    """Metres: ± of the depth by the model's own distribution, see ``DepthMap.std``; None where it has none."""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """The depth of one photo, at the photo's size.

    What follows from the depth (``valid``, ``distance``, ``points``) is computed when it is first asked for, and kept:
    ask after you have changed ``depth`` in place, not before.
    """

    depth: DepthArray
    """Metres along the optical axis (z, not the length of the ray); finite and positive everywhere."""
    std: DepthArray | None
    """Metres: standard deviation of the bin distribution, widened where the two mirrored predictions differ, times what
    was fitted to the model's errors (``Domain.std_factor``). None where the model has no distribution: DORN, NeWCRFs,
    BTS and naive heads."""
    domain: str
    """Scene type whose head made this depth, e.g. "indoor"."""
    domain_probability: dict[str, float]
    """The router's probability of each scene type. Where there is no classifier, 1 for the only or the given one."""
    image: ImageArray
    """The photo, RGB."""
    network_size: tuple[int, int]
    """(height, width) at which the model saw the photo."""
    camera: Camera
    """The camera of the photo. ``camera.source`` says who knows it: it was given, or the photo's notes tell it (exif),
    or nobody does, and it is assumed to be that of the model's training photos."""
    camera_note: str = ""
    """The photo's notes in a few words: what the camera is known by ("its 35-mm focal length is 26 mm"), or why they
    tell none ("it has no EXIF"). Empty where they were not asked."""
    focal_correction: float = 1.0
    """The factor by which depth and std were multiplied because the photo's focal length is not that of the training
    photos; 1 where they were not."""
    depth_range: tuple[float, float] = (0.0, math.inf)
    """Metres: the nearest and the farthest depth that the model gives in this scene type, corrected as ``depth`` is."""
    calibration: Calibration | None = None
    """The calibration by readings that ``depth`` and ``std`` went through last of all; None where they did not."""
    tiles: tuple[int, int] | None = None
    """(rows, columns) of the tiles that the detail of ``depth`` comes from, see ``tiles``; None where it has none."""

    def __repr__(self) -> str:
        height, width = self.size
        near, middle, far = np.quantile(self.depth, (0, 0.5, 1))
        return (
            f"DepthMap({width} x {height} pixels, {near:.2f} to {far:.2f} m, median {middle:.2f} m, {self.domain}, "
            f"camera {self.camera.source}: {self.camera.fov_x:.1f} degrees across)"
        )

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the photo and of the depth."""
        return self.depth.shape[0], self.depth.shape[1]

    @cached_property
    def maps(self) -> Maps:
        """The arrays and the camera alone, for ``outputs``."""
        return Maps(depth=self.depth, std=self.std, image=self.image, camera=self.camera, depth_range=self.depth_range)

    @property
    def confidence(self) -> DepthArray | None:
        """1 / (1 + std / depth), in (0, 1]: how narrow the model's distribution over depth is.

        It says how right the depth is only where a training tied the spread of the bins to the error
        (``TrainConfig.spread_weight``), as that of zoed-lite did, and is no probability. The released models were
        trained without; pixels of a higher confidence may be the worse ones. ``zoedepth evaluate`` measures it for your
        model and photos (AUSE: 0 is a perfect ranking, 1 is none). None where the model has no distribution over depth.
        """
        return self.maps.confidence

    @property
    def valid(self) -> Bool[np.ndarray, "height width"]:
        """True where the depth can be used: it is finite, within the model's range, and no flying pixel at a jump.

        Sky is left out where the model puts it beyond its range. No model here has learned what sky is, and one that
        puts it nearer is believed.
        """
        valid = self.maps.valid
        assert valid is not None  # there is depth
        return valid

    @property
    def intrinsics(self) -> Float[np.ndarray, "3 3"]:
        """The camera's matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], pixels, as OpenCV counts them."""
        return self.camera.matrix

    @cached_property
    def points(self) -> Float32[np.ndarray, "height width 3"]:
        """The point in space that each pixel sees, metres: x to the right, y down, z forward, as in OpenCV."""
        return unproject(self.depth, self.camera)

    @property
    def normals(self) -> Float32[np.ndarray, "height width 3"]:
        """The unit normal of the surface at each pixel, towards the camera, in the axes of ``points``; NaN where it is
        not ``valid``."""
        return estimate_normals(np.where(self.valid, self.depth, np.float32(np.nan)), self.camera)

    @cached_property
    def distance(self) -> DepthArray:
        """Metres from the camera to what each pixel sees, along its ray; depth is measured along the optical axis."""
        return self.depth * np.linalg.norm(self.camera.rays(), axis=-1)

    def at(self, x: float, y: float) -> DepthAt:
        """Return the depth at a pixel, in metres, and its ± where the model has a distribution.

        It is that of the nearest pixel: between two pixels there may be a jump, and nothing at the depth between.

        Args:
            x: column; the centres of the leftmost pixels are at 0.
            y: row; the centres of the top pixels are at 0.

        Raises:
            InputError: it is outside the photo, or the depth there is not ``valid``.
        """
        row, column = self._pixel(x, y)
        return DepthAt(float(self.depth[row, column]), None if self.std is None else float(self.std[row, column]))

    def measure(self, one: tuple[float, float], other: tuple[float, float]) -> float:
        """Return the distance in metres between the points in space that two pixels (x, y) see.

        It is the length of the straight line between the points. It takes the camera's field of view for right: see
        ``camera.source``.

        Raises:
            InputError: one of them is outside the photo, or the depth there is not ``valid``.
        """
        first, second = (self.camera.ray(*place) * self.at(*place).depth for place in (one, other))
        return math.dist(first, second)

    def calibrate(
        self,
        readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
        *,
        along_ray: bool = False,
        form: Form = "scale",
    ) -> "DepthMap":
        """Return this depth map with its metres put right by what was measured; ``calibration`` of the result says how.

        Args:
            readings: (x, y, metres) of pixels, ((x, y), (x, y), metres) of the distance of two points, or a sparse
                depth map; see ``calibration.calibrate``.
            along_ray: readings are from the lens to the thing, as a tape measure gives them, and not along the axis.
            form: "scale-shift" also fits a power of the depth where the readings say that it helps.

        Raises:
            InputError: a reading is outside of the photo, at a pixel that is not ``valid``, or not above 0; it is along
                the ray or a distance, and the camera is "assumed"; or the depth is calibrated already.
        """
        return self.calibrated(self.find_calibration(readings, along_ray=along_ray, form=form))

    def find_calibration(
        self,
        readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
        *,
        along_ray: bool = False,
        form: Form = "scale",
        photo: str = "",
        earlier: Calibration | None = None,
    ) -> Calibration:
        """Return the calibration that readings tell of this depth, without the name of a model.

        Args:
            readings: see ``calibrate``.
            along_ray: see ``calibrate``.
            form: see ``calibrate``.
            photo: name of this photo, to tell its readings from those of others.
            earlier: calibration of other photos of the same camera, see ``calibration.calibrate``.

        Raises:
            InputError: a reading cannot be compared with the depth, or needs the camera, which nobody knows; or the
                earlier calibration is of something else.
        """
        found = calibrate(
            self.depth,
            readings,
            camera=self.camera,
            valid=self.valid,
            along_ray=along_ray,
            form=form,
            photo=photo,
            earlier=earlier,
        )
        between = any(len(reading.points) == 2 for reading in found.readings if reading.photo == photo)
        if (between or along_ray) and self.camera.source == "assumed":
            raise InputError(
                f"{'the distance of two points' if between else 'a reading along the ray'} needs the camera of "
                f"{photo or 'the photo'}, which is not known ({self.camera_note or 'nobody says it'}): say its field "
                "of view (--fov-x or --fov-diagonal, from Python Lens), or measure depth along the optical axis"
            )
        return replace(found, domain=self.domain, focal_corrected=self.focal_correction != 1)

    def mismatches(
        self, calibration: Calibration, *, network: str | None = None, weights: str | None = None
    ) -> tuple[str, ...]:
        """Return the reasons for which a calibration does not hold for this depth map; none where it holds.

        Args:
            calibration: see ``calibrated``.
            network: name of the model that made this depth; None does not compare it.
            weights: hash of its weights, see ``weights.load.weights_of``; None does not compare them.
        """
        return calibration.mismatches(
            camera=self.camera,
            network=network,
            domain=self.domain,
            focal_corrected=self.focal_correction != 1,
            weights=weights,
        )

    def calibrated(
        self, calibration: Calibration, *, network: str | None = None, weights: str | None = None
    ) -> "DepthMap":
        """Return this depth map with its metres put right by a calibration of the same camera.

        Args:
            calibration: from ``calibrate``, or from a file (``calibration.read_calibration``).
            network: see ``mismatches``.
            weights: see ``mismatches``.

        Raises:
            InputError: the calibration is of another camera, model or scene type, was made with another correction by
                the focal length, or the depth is calibrated already.
        """
        if self.calibration is not None:
            raise InputError("this depth is calibrated already: calibrate the depth as the model gave it")
        if reasons := self.mismatches(calibration, network=network, weights=weights):
            raise InputError(f"the calibration does not hold for this photo: {'; '.join(reasons)}. Make one for it")
        near, far = calibration.apply(np.array([self.depth_range], np.float32))[0].tolist()
        return replace(
            self,
            depth=calibration.apply(self.depth),
            std=None if self.std is None else calibration.apply_to_std(self.std, self.depth),
            depth_range=(near, far),
            calibration=calibration,
        )

    def mesh(self, *, max_triangles: int | None = Options.max_triangles) -> Mesh:
        """Return the surface that the valid pixels see: triangles between neighbours, but not across jumps of depth.

        Args:
            max_triangles: triangles, at most; None keeps all, one or two for each pixel.

        Raises:
            MissingExtraError: there are more, and fast-simplification is not installed.
        """
        return build_mesh(self.depth, self.camera, valid=self.valid, max_triangles=max_triangles)

    def preview(self, *, vmin: float | None = None, vmax: float | None = None, colormap: str = "magma_r") -> ImageArray:
        """Return the photo beside its coloured depth with a bar in metres; see ``colors.preview``."""
        return colors.preview(self.image, self.depth, vmin=vmin, vmax=vmax, colormap=colormap)

    def save(
        self,
        path: str | Path,
        *,
        scale: float | None = None,
        max_triangles: int | None = Options.max_triangles,
        max_depth: float | None = None,
    ) -> None:
        """Write the depth in the format of the suffix, whole or not at all.

        ``zoedepth.read_depth`` reads depth back from these: .png holds 16 bits, with the scale in its text chunks;
        .npy, .tif, .tiff and .pfm hold float32 metres, .exr the same as its channel Z, with the photo as R, G and B;
        .npz holds ``depth``, ``std``, ``confidence``, ``valid`` and the ``intrinsics`` of the camera.

        .ply and .pcd hold the points of the valid pixels with colours and normals, .glb and .usdz the surface as a mesh
        with the photo on it, all in metres, and .html a page for the browser that shows it. .jpg, .jpeg and .webp hold
        the preview, a picture.

        Args:
            path: where to write; missing folders are made.
            scale: PNG levels per metre. None is 1000 (millimetres), or 256 where the depth exceeds 65.535 m. Give it
                where other programs expect one scale of all files.
            max_triangles: triangles of a .glb, .usdz or .html, at most. None keeps all, one or two for each pixel.
            max_depth: metres beyond which a pixel makes no point and no surface, as for the sky; None keeps all.

        Warns:
            InputWarning: a PNG has 256 levels per metre, because the depth exceeds 65.535 m; or depth was clipped.

        Raises:
            InputError: another suffix, or there is nothing to make points or a surface of.
            MissingExtraError: a library that the format needs is not installed.
        """
        save_maps(path, self.maps, Options(png_scale=scale, max_triangles=max_triangles, max_depth=max_depth))

    def _pixel(self, x: float, y: float) -> tuple[int, int]:
        """Return the (row, column) of the pixel at x and y, one whose depth is valid."""
        height, width = self.size
        if not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):  # also where one is not a number
            raise InputError(
                f"x = {x:g}, y = {y:g} is outside the photo of {width} x {height} pixels: x is the column, from 0 to "
                f"{width - 1}, and y the row, from 0 to {height - 1}"
            )
        row, column = math.floor(y + 0.5), math.floor(x + 0.5)
        if not self.valid[row, column]:
            raise InputError(
                f"there is no depth to rely on at x = {x:g}, y = {y:g}: it lies at the border of a thing, between near "
                "and far, or outside of the model's range. Take a pixel beside it"
            )
        return row, column
