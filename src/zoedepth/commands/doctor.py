"""``zoedepth doctor``: what this installation has, what it lacks, and whether it predicts."""

import json
import os
import platform
import shutil
import time
from collections import defaultdict
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro


def doctor(*, json_: Annotated[bool, tyro.conf.arg(name="json")] = False) -> int:
    """Look at this installation: versions, processor, extras, folders, and one prediction with zoed-lite.

    Put what it prints into a report of a bug. Exit codes: 0 it predicts, 1 it does not.

    Args:
        json_: print one JSON object and nothing else.
    """
    from zoedepth.runtimes.machine import this_machine, versions
    from zoedepth.weights.openvino_processor import has_bfloat16

    machine, problem, seconds = this_machine(), None, None
    try:
        seconds = _seconds_of_a_prediction()
    except Exception as error:  # whatever is broken is what the command is asked for
        problem = f"{type(error).__name__}: {error}"
    found = {
        "package": str(Path(__file__).parents[1]),
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": str(machine),
        "bfloat16": has_bfloat16(),
        "versions": versions(),
        "missing": _missing_extras(),
        "folders": _folders(),
        "seconds": None if seconds is None else round(seconds, 3),
        "problem": problem,
    }
    if json_:
        print(json.dumps(found))
    else:
        _tell(found)
    return 0 if problem is None else 1


def _tell(found: dict) -> None:
    versions = {name: number or "not installed" for name, number in found["versions"].items()}
    print(f"zoedepth {versions.pop('zoedepth')} in {found['package']}")
    print(f"Python {found['python']}, {found['system']}")
    print(f"{found['processor']}, bfloat16 {'in' if found['bfloat16'] else 'not in'} hardware")
    print(", ".join(f"{name} {number}" for name, number in versions.items()))
    if found["missing"]:
        print("\nExtras that are not installed, or not whole:")
        for extra, modules in found["missing"].items():
            print(f"  pip install 'zoedepth[{extra}]'".ljust(38) + f"lacks {', '.join(modules)}")
    else:
        print("\nAll extras are installed.")
    print("\nFolders:")
    for name, about in found["folders"].items():
        can = "can be written" if about["writable"] else "CANNOT BE WRITTEN"
        print(f"  {name:<8} {about['path']}: {can}, {about['free_gb']:g} GB free")
    if found["problem"] is None:
        print(f"\nzoed-lite predicts: the second photo of 480x640 took {found['seconds']:.2f} s.")
    else:
        print(f"\nzoed-lite DOES NOT PREDICT: {found['problem']}")


def _seconds_of_a_prediction() -> float:
    """Predict a photo twice, and return the time of the second: the first one loads libraries."""
    import numpy as np

    from zoedepth.predict import Predictor
    from zoedepth.weights.load import load_for_prediction

    predictor = Predictor(load_for_prediction("zoed-lite"))
    photo = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    predictor(photo)
    started = time.perf_counter()
    depth = predictor(photo).depth
    seconds = time.perf_counter() - started
    if not (np.isfinite(depth).all() and (depth > 0).all()):
        raise ArithmeticError("the depth of a photo is not finite, or not above 0")
    return seconds


def _missing_extras() -> dict[str, list[str]]:
    """Return the extras of which a module is not installed, and these modules."""
    from zoedepth.errors import OPTIONAL

    missing: dict[str, list[str]] = defaultdict(list)
    for module, extra in OPTIONAL.items():
        if find_spec(module) is None:
            missing[extra].append(module)
    return dict(missing)


def _folders() -> dict[str, dict[str, object]]:
    """Return the folders that files are fetched to or kept in; one that is not there yet is made in the next above."""
    from zoedepth.download import cache_home
    from zoedepth.weights.releases import download_folder

    folders = {"weights": download_folder(), "cache": cache_home() / "zoedepth", "here": Path.cwd()}
    found: dict[str, dict[str, object]] = {}
    for name, path in folders.items():
        there = next(above for above in (path, *path.absolute().parents) if above.is_dir())
        free = round(shutil.disk_usage(there).free / 1e9, 1)
        found[name] = {"path": str(path), "writable": os.access(there, os.W_OK | os.X_OK), "free_gb": free}
    return found
