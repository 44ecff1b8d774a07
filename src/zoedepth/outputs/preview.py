"""The photo beside its coloured depth, as a JPEG."""

from pathlib import Path

from zoedepth.colors import preview, preview_relative
from zoedepth.images import PICTURE_SUFFIXES, write_image
from zoedepth.outputs.output import Maps, Options, Output, Written, needed


def _write(path: Path, maps: Maps, options: Options) -> Written:
    image = needed(maps, "image")
    if maps.depth is None:
        picture = preview_relative(image, needed(maps, "relative"))
    else:
        picture = preview(image, maps.depth, vmin=options.vmin, vmax=options.vmax, colormap=options.colormap)
    write_image(path, picture)
    return Written()


# A .png is depth.
PREVIEW = Output(
    "_preview.jpg",
    "the photo beside its coloured depth",
    _write,
    suffixes=tuple(suffix for suffix in PICTURE_SUFFIXES if suffix != ".png"),
    maps=("depth", "relative"),
)
