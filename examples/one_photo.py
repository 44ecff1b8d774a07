"""Depth in metres of one photo.

python examples/one_photo.py photo.jpg     # without a photo: a cup of coffee that scikit-image brings
"""

import sys
from pathlib import Path

from skimage import data

from zoedepth import Predictor, load_model
from zoedepth.images import write_image


def main(photo: str | None = None) -> None:
    """Print how near and far the photo reaches, and write its depth and a preview of it."""
    predictor = Predictor(load_model("zoed-lite"), device="auto")
    result = predictor(photo or data.coffee())
    print(f"{result.domain}: {result.depth.min():.2f} to {result.depth.max():.2f} m")
    result.save("depth.png")  # 16 bits, millimetres
    write_image(Path("preview.jpg"), result.preview())


if __name__ == "__main__":
    main(*sys.argv[1:3])
