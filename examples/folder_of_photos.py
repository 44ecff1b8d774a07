"""Depth of a folder of photos, several at a time. A photo that fails does not stop the others.

python examples/folder_of_photos.py photos/ depth/
"""

import sys
from pathlib import Path

from zoedepth import Predictor, load_model
from zoedepth.batch import Request, find_photos, predict_all, share_cores

WORKERS = 2


def main(folder: str, out: str) -> None:
    """Write depth as PNG and as NumPy's npz for every photo, and print what became of each."""
    found = find_photos([folder], Path(out))
    with share_cores(WORKERS):
        predictor = Predictor(load_model("zoed-lite"))
        request = Request(model="zoed-lite", outputs=("depth", "npz"))
        for outcome in predict_all(found.photos, predictor, request, workers=WORKERS):
            print(outcome.failure or f"{outcome.photo.path}: {outcome.photo.file('_depth.png')}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
