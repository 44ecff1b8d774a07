"""Measure how many flying pixels are found in rendered rooms, and how many good ones are lost, as docs/three-d.md says.

python -m benchmarks flying
"""

import numpy as np
from rich.console import Console
from rich.table import Table
from tests.geometry.flying import blurred, draw_room

from zoedepth.geometry.jumps import flying_pixels

N_ROOMS, SIZE = 24, (480, 640)


def main() -> None:
    """Print how much is removed of the points of rooms, for depth that is reduced in two ways and enlarged again."""
    table = Table(
        "depth reduced by", "flying", "of them removed", "of the good ones", "of all others",
        "worst room, removed", "worst room, good ones", title=f"{N_ROOMS} rooms, {SIZE[1]} x {SIZE[0]}",
    )  # fmt: skip
    rooms = [draw_room(seed, SIZE) for seed in range(N_ROOMS)]
    for reduced_by in ("area", "stride"):
        rows = []
        for room in rooms:
            case = blurred(room, reduced_by=reduced_by)
            found = flying_pixels(case.depth, case.camera)
            others = ~case.flying
            rows.append([
                found.size, case.flying.sum(), (found & case.flying).sum(), case.good.sum(),
                (found & case.good).sum(), others.sum(), (found & others).sum(),
            ])  # fmt: skip
        n, flying, removed, good, lost, others, lost_others = np.array(rows, float).T
        table.add_row(
            reduced_by,
            f"{flying.sum() / n.sum():.1%}",
            f"{removed.sum() / flying.sum():.1%}",
            f"{lost.sum() / good.sum():.2%}",
            f"{lost_others.sum() / others.sum():.2%}",
            f"{(removed / flying).min():.1%}",
            f"{(lost / good).max():.1%}",
        )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
