"""The depth of one photo: metres, how sure they are, and the files they can be written as."""

from dataclasses import dataclass
from pathlib import Path

from zoedepth import colors
from zoedepth.images import DepthArray, ImageArray
from zoedepth.outputs import Maps, Options, write_maps


@dataclass(frozen=True, eq=False)
class DepthMap:
    """The depth of one photo, at the photo's size."""

    depth: DepthArray
    """Metres along the optical axis (z, not the length of the ray); finite and positive everywhere."""
    std: DepthArray | None
    """Metres: standard deviation of the bin distribution, widened where the two mirrored predictions differ. None where
    the model has no distribution: DORN, NeWCRFs, BTS and naive heads."""
    domain: str
    """Scene type whose head made this depth, e.g. "indoor"."""
    domain_probability: dict[str, float]
    """The router's probability of each scene type. Where there is no classifier, 1 for the only or the given one."""
    image: ImageArray
    """The photo, RGB."""
    network_size: tuple[int, int]
    """(height, width) at which the model saw the photo."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the photo and of the depth."""
        return self.depth.shape[0], self.depth.shape[1]

    @property
    def maps(self) -> Maps:
        """The arrays alone, for ``outputs``."""
        return Maps(depth=self.depth, std=self.std, image=self.image)

    @property
    def confidence(self) -> DepthArray | None:
        """1 / (1 + std / depth), in (0, 1]: how narrow the model's distribution over depth is.

        **Do not take it for how right the depth is.** Nothing in the training ties the spread of the bins to the error,
        so it is no probability, and need not even rank pixels: those of zoed-lite with a higher confidence are often
        the worse ones. ``zoedepth evaluate`` measures it for your model and photos (AUSE: 0 is a perfect ranking, 1 is
        none). None where the model has no distribution over depth.
        """
        return self.maps.confidence

    def preview(self, *, vmin: float | None = None, vmax: float | None = None, colormap: str = "magma_r") -> ImageArray:
        """Return the photo beside its coloured depth with a bar in metres; see ``colors.preview``."""
        return colors.preview(self.image, self.depth, vmin=vmin, vmax=vmax, colormap=colormap)

    def save(self, path: str | Path, *, scale: float | None = None) -> None:
        """Write the depth in the format of the suffix, whole or not at all.

        .png holds 16 bits, with the scale in its text chunks (``zoedepth.read_depth`` reads it back). .npy holds
        float32 metres. .npz holds the same as ``depth``, with ``std`` and ``confidence`` beside it. .jpg, .jpeg and
        .webp hold the preview, a picture.

        Args:
            path: where to write; missing folders are made.
            scale: PNG levels per metre. None is 1000 (millimetres), or 256 where the depth exceeds 65.535 m.

        Raises:
            InputError: another suffix.
        """
        write_maps(path, self.maps, Options(png_scale=scale))
