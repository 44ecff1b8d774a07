"""WSVD: stereo videos of the web, in a layout of our own, because the authors publish only addresses of videos."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from zoedepth.datasets.movies3d import Movies3D
from zoedepth.datasets.published import About, PairFiles
from zoedepth.images import ImageArray, read_image


class WSVD(Movies3D):
    """Stereo videos of all kinds from the web; disparity by optical flow, signed. The camera is unknown.

    The authors store no depth, so you have to make the folder yourself: download the videos that are still there,
    extract frames, stretch the halves to twice their width, and run an optical flow network from the left to the right
    one. Write its negated horizontal part with its uncertainty, of any size, as the scripts of 3D Movies do. The
    authors also check that the vertical part is at most a pixel. Their lists of clips are pickles and are not read.
    """

    about = About(
        title="WSVD",
        page="https://sites.google.com/view/wsvd/home",
        licence="of the videos' owners",
        kind="disparity",
        domain="",
        layout="""
<video>/frames/000000.jpg          (left and right side by side, each squeezed to half its width)
<video>/disparity/000000.png       (to be made; encoded as those of 3D Movies)
<video>/uncertainty/000000.png     (optional, likewise)
""",
        unit=Movies3D.about.unit,
        splits={"train": None},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        pairs = []
        for folder in self.find("*/frames"):
            uncertainty = folder.with_name("uncertainty")
            for photo in sorted(folder.glob("*.jpg")):
                name = f"{photo.stem}.png"
                masks = (uncertainty / name,) if uncertainty.is_dir() else ()
                pairs.append(PairFiles(photo, folder.with_name("disparity") / name, masks))
        return pairs

    def read_photo(self, pair: PairFiles) -> ImageArray:
        """Read the left half, stretched to its true proportions."""
        both = read_image(pair.image)
        left = Image.fromarray(both[:, : both.shape[1] // 2])
        return np.asarray(left.resize((2 * left.width, left.height), Image.Resampling.BILINEAR))
