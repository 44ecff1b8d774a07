"""``zoedepth export MODEL --to FORMAT``: write a model for other programs."""

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from zoedepth.errors import InputError
from zoedepth.folders import check_writable
from zoedepth.stored import to_json


def export(
    model: tyro.conf.Positional[str],
    *,
    to: Literal["onnx", "openvino", "torch-export"],
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    int8: bool = False,
    calibrate: Path | None = None,
    size: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="HEIGHT WIDTH")] = None,
    compat: tuple[str, ...] = (),
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Write a model for another program, then run the file and check that the depth is the same.

    `zoedepth predict` and `zoedepth evaluate` take the .onnx and .xml files as --model.

    Args:
        model: a name of `zoedepth models`, a file or folder of weights, or a Hugging Face id.
        to: format to write: onnx, openvino or torch-export.
        out: file to write; without it, the model's name with the suffix of the format (.onnx, .xml and .bin, .pt2).
        int8: compute encoder and decoder in 8-bit integers (openvino only): faster, a little less exact.
        calibrate: folder of photos like those that the model will see; int8 needs it and uses at most 300 of them.
        size: height and width of a torch-export, multiples of 32; without it, the model's.
        compat: see `zoedepth predict`.
        json_: print one JSON object instead of the name: files, format, int8, difference (the largest median relative
            difference to torch's depth; the mean one over photos in int8), licence and trained_on.
    """
    from zoedepth.commands.progress import download_progress
    from zoedepth.export.write import SUFFIXES, check_wish, export_model
    from zoedepth.photos import find_photos
    from zoedepth.runtimes.benchmark import MAX_CALIBRATION
    from zoedepth.weights.load import load_model

    source = Path(model)
    name = source.stem if source.is_file() else source.name  # what stands behind a dot of a folder is no format
    path = out or Path(f"{name}{'-int8' if int8 else ''}{SUFFIXES[to]}")
    # What is wrong with the wish is said before a model is downloaded.
    check_wish(path, to=to, int8=int8, size=size)
    check_writable(path.parent, option="--out")
    if calibrate is not None and not int8:
        raise InputError("--calibrate is for --int8 only: add --int8, or leave it out")
    photos = []
    if calibrate is not None:
        # No thumbnails of other programs, and none of the pictures that this one has written.
        photos = [photo.path for photo in find_photos([str(calibrate)], path.parent).photos]
        if not photos:
            raise InputError(f"--calibrate {calibrate} holds no photos: give a folder with photos (.jpg, .png ...)")
        photos = photos[:: -(-len(photos) // MAX_CALIBRATION)]  # evenly spread over the folder
    if int8 and not photos:
        raise InputError("--int8 needs --calibrate FOLDER, a folder of photos like those the model will see")
    with download_progress() as progress:
        network = load_model(model, compat=compat, progress=progress)
    console = Console(stderr=True, highlight=False)
    with console.status(f"writing and checking {path.name}"):
        tell = partial(console.print, soft_wrap=True, markup=False)
        difference = export_model(network, path, to=to, int8=int8, photos=photos, size=size, tell=tell)
    what = "mean over the photos of the check" if int8 else "largest median of the check"
    console.print(f"depth differs from torch's by {difference:.1e} of itself ({what})")
    if json_:
        files = [path, path.with_suffix(".bin")] if to == "openvino" else [path]
        about = network.provenance
        print(to_json({
            "files": list(map(str, files)), "format": to, "int8": int8, "difference": difference,
            "licence": about.licence, "trained_on": about.trained_on,
        }))  # fmt: skip
    else:
        print(path)
    return 0
