"""The coloured depth alone, as large as the photo."""

from pathlib import Path

from zoedepth.colors import colorize, depth_range
from zoedepth.images import write_image
from zoedepth.outputs.output import Maps, Options, Output, Written, needed

_PERCENTILES = (1.0, 99.0)  # as in the preview


def _write(path: Path, maps: Maps, options: Options) -> Written:
    if maps.depth is None:
        relative = needed(maps, "relative")
        low, high = float(relative.min()), float(relative.max())
        share = (relative - low) / max(high - low, 1e-12)
        # 0 would be drawn as unknown.
        write_image(path, colorize(share.clip(1e-5, None), vmin=0.0, vmax=1.0, colormap="magma"))
        return Written()
    vmin, vmax = depth_range(maps.depth, vmin=options.vmin, vmax=options.vmax, percentiles=_PERCENTILES)
    write_image(path, colorize(maps.depth, vmin=vmin, vmax=vmax, colormap=options.colormap))
    return Written({"color_range": [round(vmin, 4), round(vmax, 4)], "colormap": options.colormap})


COLOR = Output("_color.png", "the coloured depth alone", _write, maps=("depth", "relative"))
