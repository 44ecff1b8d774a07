"""Makes the pictures of meshes and clouds in docs/images, by the pages of `zoedepth view` in a headless browser.

    python scripts/pictures.py [--browser chromium] [NAME ...]

three-d.jpg     photographs that come with scikit-image, turned; one also with the depth that was measured
panorama.jpg    a rendered panorama and its distances, and looks at its surface from inside
turntables.jpg  a rendered room as GLB, PLY and PCD, turned: all of them the right side up, in the same colours
tiles.jpg       a rendered street of 8 megapixels, its depth seen whole and in tiles, and a part of all three
"""

import argparse
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from zoedepth import Predictor, load_model, predict_tiled
from zoedepth.colors import colorize, panel, sheet
from zoedepth.commands.demo import FOCAL_PX, motorcycle_depth
from zoedepth.geometry.camera import Camera
from zoedepth.images import ImageArray, write_image
from zoedepth.outputs import Maps, write_maps
from zoedepth.outputs.html import write_page_of_file, write_page_of_maps
from zoedepth.panorama import predict_panorama
from zoedepth.synthetic.dataset import make_picture
from zoedepth.synthetic.panorama import make_panorama

IMAGES = Path(__file__).parent.parent / "docs" / "images"
PANEL = (320, 440)
_TRIES, _EMPTY = 6, 12  # a busy machine may take the picture before the page is ready: nearly of one colour


class Browser:
    """A headless browser, which takes pictures of pages."""

    def __init__(self, program: str, folder: Path) -> None:
        self.program = program
        self.folder = folder

    def look(self, page: Path, angle: float) -> ImageArray:
        """Return a picture of a page, turned by so many degrees."""
        file = self.folder / "picture.png"
        height, width = (2 * side for side in PANEL)
        for _ in range(_TRIES):
            subprocess.run(
                [
                    self.program, "--headless=new", "--no-sandbox", "--use-angle=swiftshader",
                    "--enable-unsafe-swiftshader", "--hide-scrollbars", f"--user-data-dir={self.folder / 'profile'}",
                    f"--window-size={width},{height}", "--virtual-time-budget=20000", f"--screenshot={file}",
                    f"file://{page}#angle={angle}&bare",
                ],
                check=True, capture_output=True, timeout=300,
            )  # fmt: skip
            picture = np.asarray(Image.open(file).convert("RGB").resize(PANEL[::-1], Image.Resampling.LANCZOS))
            if picture.std() > _EMPTY:
                return picture
        raise RuntimeError(f"{self.program} shows nothing on {page}")

    def shot(self, maps: Maps, angle: float, *, cloud: bool = False) -> ImageArray:
        """Return a picture of the surface, or the points, of a photo."""
        page = self.folder / "page.html"
        write_page_of_maps(page, maps, title="", cloud=cloud, most=400_000)
        return self.look(page, angle)


def three_d(browser: Browser) -> ImageArray:
    """Return photographs beside their surfaces and points."""
    from skimage import data

    predictor = Predictor(load_model("zoed-lite"))
    coffee, motorcycle = data.coffee(), data.stereo_motorcycle()[0]
    of_coffee = predictor(coffee).maps
    camera = Camera.from_focal(FOCAL_PX, (motorcycle.shape[0], motorcycle.shape[1]))
    of_motorcycle = predictor(motorcycle, camera=camera).maps
    measured = Maps(depth=motorcycle_depth(), image=motorcycle, camera=camera)
    return sheet([
        [
            _panel(coffee, "a photograph"),
            _panel(browser.shot(of_coffee, -18), "its surface, as predicted"),
            _panel(browser.shot(of_coffee, 18, cloud=True), "its points"),
        ],
        [
            _panel(motorcycle, "a photograph"),
            _panel(browser.shot(of_motorcycle, 14), "its surface, as predicted"),
            _panel(browser.shot(measured, 14), "the surface of the measured depth"),
        ],
    ])  # fmt: skip


def panorama(browser: Browser) -> ImageArray:
    """Return a panorama of a rendered room, its distances, and two looks at its surface."""
    image, _ = make_panorama("indoor", 768, np.random.default_rng(12))
    found = predict_panorama(Predictor(load_model("zoed-lite")), image, domain="indoor")
    page = browser.folder / "page.html"
    write_page_of_maps(page, found.maps, title="", most=400_000)
    wide = (PANEL[0], 2 * PANEL[0])
    return sheet([
        [panel(image, size=wide, caption="a panorama"), _panel(browser.look(page, 0), "seen from inside, ahead")],
        [
            panel(colorize(found.distance, percentiles=(1, 99)), size=wide, caption="its distances, as predicted"),
            _panel(browser.look(page, 180), "and behind, across the border of the photo"),
        ],
    ])  # fmt: skip


def turntables(browser: Browser) -> ImageArray:
    """Return a room as every kind of file of three dimensions, turned."""
    image, depth, intrinsics = make_picture("indoor", (360, 480), np.random.default_rng(3))
    maps = Maps(depth=depth, image=image, camera=Camera.of(intrinsics, (360, 480)))
    rows = []
    for kind in ("glb", "ply", "pcd"):
        file, page = browser.folder / f"room.{kind}", browser.folder / "page.html"
        write_maps(file, maps)
        write_page_of_file(page, file)
        rows.append([_panel(browser.look(page, angle), f"{kind}, {angle} degrees") for angle in (-30, 0, 30)])
    return sheet(rows)


def tiles(browser: Browser) -> ImageArray:
    """Return a photo of 8 megapixels, its depth as predicted whole and in tiles, and a part of all three below."""
    size = (2160, 3840)
    image, _, intrinsics = make_picture("outdoor", size, np.random.default_rng((24, 1)))
    predictor, camera = Predictor(load_model("zoed-lite")), Camera.of(intrinsics, size)
    whole = predictor(image, camera=camera).depth
    finer = predict_tiled(predictor, image, tiles=(6, 6), camera=camera).depth
    captions = ("a photo of 3840 x 2160", "its depth, seen whole", "and in 6 x 6 tiles")
    closer = ("a part of it", "seen whole", "and in tiles")
    rows = []
    for part, words in ((np.s_[:, :], captions), (np.s_[1000:1720, 2240:3520], closer)):
        vmin, vmax = (float(value) for value in np.percentile(finer[part], (1, 99)))
        colors = [colorize(depth[part], vmin=vmin, vmax=vmax) for depth in (whole, finer)]
        shown = zip((image[part], *colors), words, strict=True)
        rows.append([panel(picture, size=(270, 480), caption=caption) for picture, caption in shown])
    return sheet(rows)


def _panel(image: ImageArray, caption: str) -> ImageArray:
    height, width = PANEL
    wanted = width / height
    side = (min(image.shape[0], round(image.shape[1] / wanted)), min(image.shape[1], round(image.shape[0] * wanted)))
    top, left = ((whole - part) // 2 for whole, part in zip(image.shape[:2], side, strict=True))
    return panel(image[top : top + side[0], left : left + side[1]], size=PANEL, caption=caption)


PICTURES: dict[str, Callable[[Browser], ImageArray]] = {
    "three-d": three_d,
    "panorama": panorama,
    "turntables": turntables,
    "tiles": tiles,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(PICTURES)}; all without one")
    parser.add_argument("--browser", default="chromium", help="Chromium or Chrome")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        browser = Browser(arguments.browser, Path(folder))
        for name in arguments.names or PICTURES:
            write_image(IMAGES / f"{name}.jpg", PICTURES[name](browser))
    return 0


if __name__ == "__main__":
    sys.exit(main())
