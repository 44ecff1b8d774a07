"""Metres put right by measurements: some readings of a tape measure, a sparse depth map, or a known distance.

A model sees the shape of a room better than its size. One factor on all depths mends the size; some readings tell it.

    calibration = calibrate(result.depth, [(320, 240, 2.35), (50, 400, 1.1), (600, 90, 4.02)])
    depth = calibration.apply(result.depth)
    write_calibration("camera.json", calibration)  # for all photos of this camera: zoedepth predict --calibration
"""

from zoedepth.calibration.calibration import (
    COVERAGE,
    Calibration,
    check_replaceable,
    read_calibration,
    write_calibration,
)
from zoedepth.calibration.fit import Form, calibrate
from zoedepth.calibration.readings import Distance, Point, Reading, places_to_measure
from zoedepth.calibration.undo import is_calibrated, undo_files

__all__ = [
    "COVERAGE",
    "Calibration",
    "Distance",
    "Form",
    "Point",
    "Reading",
    "calibrate",
    "check_replaceable",
    "is_calibrated",
    "places_to_measure",
    "read_calibration",
    "undo_files",
    "write_calibration",
]
