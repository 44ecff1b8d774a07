"""Rendered rooms and streets with exact depth: a data set that needs no files."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch.utils.data import Dataset

from zoedepth.data.sample import Sample, Target
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.synthetic.photo import photograph
from zoedepth.synthetic.pose import Pose, count_parts
from zoedepth.synthetic.render import View, render
from zoedepth.synthetic.room import build_room
from zoedepth.synthetic.scene import Arrays
from zoedepth.synthetic.street import build_street
from zoedepth.synthetic.trace import Tracer

_BUILDERS = {"indoor": build_room, "outdoor": build_street}
_ATTEMPTS = 12
"""Poses tried in a scene before another is built."""


class SyntheticScenes(Dataset[Sample]):
    """Pictures of scenes that are made up when they are asked for, each of a scene of its own.

    The same (seed, index, size, domains) gives the same bits in every process of a machine, in any order.

    Args:
        n: number of samples.
        size: (height, width) of the pictures.
        seed: chooses all scenes, cameras and photos.
        domains: "indoor" for rooms, "outdoor" for streets. They take turns: sample i has domain i modulo their
            number.
        fields_of_view: narrowest and widest lens, degrees across the picture's width. The focal length is drawn
            log-uniformly between theirs. None leaves the lenses to the scenes: 45 to 90 degrees, rooms most often near
            63.

    Raises:
        InputError: a domain is unknown, the size is below 32 pixels, ``n`` below 1 or ``seed`` below 0, or fields of
            view are not between 10 and 130 degrees.
    """

    def __init__(
        self,
        n: int = 10_000,
        *,
        size: tuple[int, int] = (288, 384),
        seed: int = 0,
        domains: Sequence[str] = ("indoor", "outdoor"),
        fields_of_view: tuple[float, float] | None = None,
    ) -> None:
        if not domains or set(domains) - set(_BUILDERS):
            raise InputError(f"synthetic scenes have no domains {list(domains)}. Choose from {list(_BUILDERS)}.")
        if min(size) < 32 or n < 1 or seed < 0:
            raise InputError(
                f"cannot render synthetic scenes with n={n}, seed={seed}, size={size}. "
                "Use n >= 1, seed >= 0 and at least 32 pixels each way."
            )
        if fields_of_view is not None and not 10 <= fields_of_view[0] <= fields_of_view[1] <= 130:
            raise InputError(
                f"fields of view must be two numbers from 10 to 130 degrees, the smaller first; got {fields_of_view}"
            )
        self.n = n
        self.size = size
        self.seed = seed
        self._domains = tuple(domains)
        self.fields_of_view = fields_of_view

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, index: int) -> Sample:
        """Build and render one scene. Depth is 0 (unknown) in the sky and in the view from a window.

        Raises:
            MissingExtraError: embreex is not installed.
        """
        if not 0 <= index < self.n:
            raise IndexError(index)
        domain = self._domains[index % len(self._domains)]
        rng = np.random.default_rng((self.seed, index))
        photo, depth, camera = make_picture(domain, self.size, rng, fields_of_view=self.fields_of_view)
        return Sample(
            image=torch.from_numpy(photo).permute(2, 0, 1).float() / 255,
            target=torch.from_numpy(depth)[None],
            mask=torch.from_numpy(depth > 0)[None],
            kind="depth",
            domain=domain,
            name=f"{domain}/{self.seed}/{index:06d}",
            camera=camera,
        )

    @property
    def domains(self) -> list[str]:
        """The scene types that occur."""
        return sorted(set(self._domains[: self.n]))

    @property
    def kinds(self) -> list[Target]:
        """The kinds of target that occur: depth alone."""
        return ["depth"]


def make_picture(
    domain: str,
    size: tuple[int, int],
    rng: np.random.Generator,
    *,
    fields_of_view: tuple[float, float] | None = None,
) -> tuple[np.ndarray, np.ndarray, Intrinsics]:
    """Draw a scene from ``rng`` and take a picture of it: (uint8 photo, float32 depth in metres or 0, camera)."""
    while True:
        place = _BUILDERS[domain](rng)
        poses = [place.draw_pose(rng) for _ in range(_ATTEMPTS)]
        if fields_of_view is not None:
            lens = _draw_lens(fields_of_view, rng)  # one for all poses: a check of the view must not prefer narrow ones
            poses = [pose._replace(field_of_view=lens) for pose in poses]
        arrays = place.scene.arrays(poses[0].position)
        tracer = Tracer(arrays)
        view = _best_view(domain, poses, size, arrays, tracer, rng)
        if view is not None:
            picture = render(place.scene, arrays, tracer, view, rng)
            return photograph(picture.color, rng), picture.depth, view.camera


def _draw_lens(fields_of_view: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw a field of view in radians whose focal length is log-uniform between those of two fields in degrees."""
    narrow, wide = (math.log(math.tan(math.radians(degrees) / 2)) for degrees in fields_of_view)
    return 2 * math.atan(math.exp(rng.uniform(narrow, wide)))


def _best_view(
    domain: str, poses: list[Pose], size: tuple[int, int], arrays: Arrays, tracer: Tracer, rng: np.random.Generator
) -> View | None:
    """Choose the view that shows most parts, of the first one to three worth taking; None if no pose is."""
    nearest, middle, n_parts = (0.45, 1.0, 9) if domain == "indoor" else (1.2, 4.0, 14)
    best: tuple[int, View] | None = None
    tries = int(rng.integers(1, 4))
    for pose in poses:
        shift = rng.normal(0, 0.01, 2) * size[1]
        view = pose.view(size, (float(shift[0]), float(shift[1])))
        count = count_parts(view, arrays, tracer, nearest=nearest, middle=middle)
        if count >= n_parts and (best is None or count > best[0]):
            best = count, view
        tries -= count >= n_parts
        if tries <= 0:
            break
    return None if best is None else best[1]
