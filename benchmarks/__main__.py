"""``python -m benchmarks [NAME ...]``: all benchmarks, or the named ones."""

import sys
from collections.abc import Callable

from benchmarks import (
    calibration,
    depthwise,
    flying,
    inference,
    linear,
    outputs,
    panorama,
    peers,
    startup,
    synthetic,
    tiles,
)

BENCHMARKS: dict[str, Callable[[], None]] = {
    "startup": startup.main,
    "inference": inference.main,
    "depthwise": depthwise.main,
    "linear": linear.main,
    "synthetic": synthetic.main,
    "outputs": outputs.main,
    "flying": flying.main,
    "panorama": panorama.main,
    "peers": peers.main,
    "calibration": calibration.main,
    "tiles": tiles.main,
}


def main() -> int:
    names = sys.argv[1:] or list(BENCHMARKS)
    if unknown := set(names) - set(BENCHMARKS):
        print(f"there is no benchmark {sorted(unknown)}; there are {list(BENCHMARKS)}", file=sys.stderr)
        return 2
    for name in names:
        print(f"\n# {name}")
        BENCHMARKS[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main())
