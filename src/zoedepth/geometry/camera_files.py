"""Cameras as files keep them: our own JSON, those of OpenCV, ROS, COLMAP, Kalibr, RealSense and NeRFs, and matrices."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, CameraSource, Intrinsics
from zoedepth.geometry.lens import Cameras, camera_of, off_middle
from zoedepth.stored import MAX_NESTING, parse_json, read_npy, read_text

_UNDISTORT = (
    "undistort the photo first, e.g. by cv2.undistort, ROS's image_proc or colmap image_undistorter, and give the "
    "camera of the result"
)
_MAX_FOV = 170.0  # degrees
_MAX_SIDE = 1e6  # pixels
_MOST_NAMED = 6
_OF_SLAM = re.compile(r"^Camera1?\.")  # ORB-SLAM's Camera.fx
_HALF = 0.5  # of a pixel: for COLMAP and NeRFs the corner of the top left pixel is at (0, 0), for OpenCV its centre

_COLMAP_MODEL = re.compile(r"[A-Z][A-Z0-9_]{2,}")
# COLMAP's models that can be pinhole cameras: how many of their numbers are focal lengths, and how many come in all.
# Those behind the principal point are lens distortion.
_COLMAP_MODELS = {
    "SIMPLE_PINHOLE": (1, 3),
    "PINHOLE": (2, 4),
    "SIMPLE_RADIAL": (1, 4),
    "RADIAL": (1, 5),
    "OPENCV": (2, 8),
    "FULL_OPENCV": (2, 12),
}
# Names and keys in what follows are without signs, and in lower case: "camera_matrix" and "cameraMatrix" are one.
# Models that are a pinhole camera where all their numbers of distortion are 0; others never are.
_PLAIN_MODELS = {
    "", "none", "pinhole", "simplepinhole", "perspective", "plumbbob", "rationalpolynomial", "radtan", "opencv",
    "radialtangential", "fullopencv", "simpleradial", "radial", "brownconrady", "inversebrownconrady",
    "modifiedbrownconrady",
}  # fmt: skip
_MODELS = ("distortionmodel", "cameramodel", "model")
_MATRICES = ("cameramatrix", "intrinsicmatrix", "intrinsics", "intrinsic", "matrix", "mtx", "k")
_FOCALS = (("fx", "fy"), ("flx", "fly"))
_CENTRES = (("cx", "cy"), ("ppx", "ppy"))
_SIDES = (("width", "height"), ("imagewidth", "imageheight"), ("w", "h"))
_SIDES_IN_ONE = ("imagesize", "resolution")  # width first
_DISTORTIONS = (
    "distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoefs", "distortion", "dist", "coeffs", "d",
    "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2",
)  # fmt: skip


@dataclass(frozen=True)
class _Stated:
    """A camera as a file states it."""

    intrinsics: Intrinsics
    size: tuple[int, int] | None = None
    """(height, width) of the photos it is for; None where the file does not say."""
    source: CameraSource = "given"
    objection: str = ""
    """The reason why it is no pinhole camera; empty where it is one."""


def read_camera(path: str | Path, size: tuple[int, int]) -> Camera:
    """Read the camera of a photo from a file, and bring it to the size of the photo.

    What is read, by the suffix and the content:

    - ``.yaml``, ``.yml``, ``.json``: OpenCV's FileStorage; ROS's ``camera_info``; Kalibr's chain of one camera; the
      sidecars and calibrations of this package, and JSON with fx, fy, cx, cy, width and height; ``transforms.json`` of
      NeRFs; RealSense's and Open3D's intrinsics; 3 x 3 numbers in brackets.
    - ``.txt``: COLMAP's ``cameras.txt``; 3 x 3 numbers, or 4 x 4 as ScanNet has them; the four numbers fx, fy, cx, cy.
    - ``.npy``: an array of 3 x 3.

    Pixels are counted as OpenCV does: the half pixel of COLMAP and NeRFs is taken off. A file that tells the size of
    its photos serves for those resized, too; see ``lens.camera_of``. For photos of that size, and where no size is
    told, its numbers come back to the last bit.

    Args:
        path: the file.
        size: (height, width) of the photo, upright.

    Raises:
        InputError: the file cannot be read, has no camera or several that differ, one with lens distortion, one that
            was only assumed, or one for photos of other proportions.
    """
    known = read_cameras(path, size)
    try:
        return camera_of(known, size)
    except InputError as error:
        raise _naming(Path(path), error) from error


def read_cameras(path: str | Path, size: tuple[int, int]) -> Camera | Cameras:
    """Read the camera of photos from a file as ``read_camera`` does; all that it has, where there are several.

    Args:
        path: the file.
        size: (height, width) of the first photo, upright. It counts where the file does not say a size, or has several
            cameras of one; where it has cameras of several sizes, one of them must be for this photo.

    Returns:
        The camera with the size that the file says, whether or not it suits the first photo: ``camera_of`` makes that
        of each photo of it, and refuses photos of other proportions.

    Raises:
        InputError: see ``read_camera``.
    """
    path = Path(path)
    read = _READERS.get(path.suffix.lower())
    if read is None:
        hint = _HINTS.get(path.suffix.lower(), "")
        raise InputError(f"{path} is no file of a camera, which ends in one of {', '.join(_READERS)}{hint}")
    try:
        found = read(path, size)
        stated = _one_of(found, size)
        if stated.objection:
            raise InputError(f"it {stated.objection}: {_UNDISTORT}")
        if stated.source == "assumed":
            raise InputError(
                "its camera was only assumed, when nobody knew it, and is no more than a guess. Say what you know "
                "instead, e.g. the field of view"
            )
        camera = Camera.of(stated.intrinsics, stated.size or size, source=stated.source)
        _check_plausible(camera, size_is_known=stated.size is not None)
        if len(set(found)) == 1:
            return camera_of(camera, camera.size)  # photos of other proportions are refused one by one
        return _sorted_out(found, path)
    except InputError as error:
        raise _naming(path, error) from error


def _naming(path: Path, error: InputError) -> InputError:
    message = str(error)
    return InputError(message if str(path) in message else f"{path}: {message}")


def _sorted_out(found: Sequence[_Stated], path: Path) -> Cameras:
    """Return the cameras of a file, and why some of them cannot be used."""
    sound, objections = [], []
    for each in found:
        if each.size is None:
            continue
        camera = Camera.of(each.intrinsics, each.size, source=each.source)
        try:
            if each.objection:
                raise InputError(f"it {each.objection}: {_UNDISTORT}")
            _check_plausible(camera, size_is_known=True)
        except InputError as error:
            objections.append((camera.size, f"{path}: {error}"))
        else:
            sound.append(camera)
    return Cameras(tuple(sound), tuple(objections))


def _check_plausible(camera: Camera, *, size_is_known: bool) -> None:
    """Refuse numbers that are not of pixels, or of pixels of a photo of another size."""
    height, width = camera.size
    # As if the axis went through the middle: numbers in parts of the sides have it in the first pixel.
    fov = [2 * math.degrees(math.atan2(side / 2, focal)) for side, focal in ((width, camera.fx), (height, camera.fy))]
    if max(fov) > _MAX_FOV:
        raise InputError(
            f"focal lengths of {camera.fx:g} and {camera.fy:g} pixels are a field of view of {fov[0]:.4g} x "
            f"{fov[1]:.4g} degrees, which is nonsense. Where they are in parts of the photo's sides, multiply "
            "them and the principal point by its width and height"
        )
    if not size_is_known and (off := off_middle(camera)):
        raise InputError(
            f"{off}: this is the camera of a photo of another size, or of one that was cropped. Write it as JSON, with "
            "fx, fy, cx, cy, and the width and height of the photo"
        )


def _read_npy(path: Path, _size: tuple[int, int]) -> list[_Stated]:
    return [_Stated(_of_matrix(read_npy(path)))]


def _read_text(path: Path, size: tuple[int, int]) -> list[_Stated]:
    rows = [line.partition("#")[0].replace(",", " ").split() for line in read_text(path).splitlines()]
    rows = [row for row in rows if row]
    if any(len(row) > 1 and _COLMAP_MODEL.fullmatch(row[1]) for row in rows):
        return [_colmap_camera(row) for row in rows]
    return [_Stated(_of_matrix([_numbers(row) for row in rows]))]


def _read_json(path: Path, _size: tuple[int, int]) -> list[_Stated]:
    text = read_text(path)
    if text.lstrip().startswith("["):  # the one reader of JSON takes objects
        text = f'{{"matrix": {text}}}'
    return [_of_keys(parse_json(text, str(path)))]


def _read_yaml(path: Path, _size: tuple[int, int]) -> list[_Stated]:
    """Read YAML with all its values as texts: nothing is made of its tags, and nothing is run."""
    import yaml

    class Loader(yaml.BaseLoader):
        """Loader that refuses what lets small files grow or nest without end."""

        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("it has aliases, which no file of a camera needs")
            if self.depth >= MAX_NESTING:
                raise yaml.YAMLError(f"it is nested deeper than {MAX_NESTING}")
            self.depth += 1
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

    text = read_text(path, max_bytes=_MAX_YAML).removeprefix("\ufeff")
    if text.startswith("%YAML:"):  # OpenCV's first line, which is no YAML
        text = text.partition("\n")[2]
    try:
        values = next(yaml.load_all(text, Loader), None)  # ROS's tools put a line of --- behind each message
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"it is no YAML ({' '.join(str(error).split())[:200]})") from error
    if not isinstance(values, dict):
        raise InputError("it has no keys, such as camera_matrix: it is no YAML of a camera")
    return [_of_keys(values)]


def _one_of(found: list[_Stated], size: tuple[int, int]) -> _Stated:
    """Return the camera that took a photo of ``size``: the size chooses, and of equal ones it may be any."""
    fitting = set([stated for stated in found if stated.size == size] or found)
    if len(fitting) > 1:
        sizes = [f"{stated.size[1]} x {stated.size[0]}" for stated in found[:_MOST_NAMED] if stated.size]
        more = ", ..." * (len(found) > _MOST_NAMED)
        raise InputError(
            f"it has {len(found)} cameras, for photos of {', '.join(sizes)}{more}, and nothing tells which of them "
            f"took this one of {size[1]} x {size[0]}: leave only its line in a copy of the file"
        )
    return fitting.pop()


def _colmap_camera(row: list[str]) -> _Stated:
    """Return the camera of a line of COLMAP's cameras.txt: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]."""
    name, model = row[0], row[1] if len(row) > 1 else ""
    size = _sides(*_numbers(row[2:4])) if len(row) > 4 else None
    n_focals, n_numbers = _COLMAP_MODELS.get(model, (0, len(row) - 4))
    if size is None or len(row) != 4 + n_numbers:
        raise InputError(
            f"its line of camera {name} is none of COLMAP's: CAMERA_ID, MODEL, WIDTH, HEIGHT and as many numbers as "
            "the model has"
        )
    if not n_focals:
        return _Stated(Intrinsics(1, 1, 0, 0), size, objection=_other_model(model))
    numbers = _numbers(row[4:])
    cx, cy, *distortion = numbers[n_focals:]
    # The focal length of models with one stands for both.
    intrinsics = Intrinsics(numbers[0], numbers[n_focals - 1], cx - _HALF, cy - _HALF)
    return _Stated(intrinsics, size, objection=_objection(distortion))


def _of_keys(values: Mapping[str, Any]) -> _Stated:
    """Return the camera of an object of JSON or a mapping of YAML."""
    for key in ("camera", "calibration", "cam0"):  # our own files, and Kalibr's
        if isinstance(values.get(key), dict):
            if "cam1" in values:
                raise InputError("it has several cameras: leave only one in a copy of the file, as cam0")
            return _of_keys(values[key])
    for key, value in values.items():  # RealSense's and others': by their names, in whatever order they stand
        if _plain(key) in _MATRICES and isinstance(value, dict) and "data" not in value:
            return _of_keys({**{other: it for other, it in values.items() if other != key}, **value})
    known = {_plain(_OF_SLAM.sub("", str(key))): value for key, value in values.items()}
    models = [str(known[key]) for key in _MODELS if key in known]
    curved = [model for model in models if _plain(model).removeprefix("distortion") not in _PLAIN_MODELS]
    if curved:
        objection = _other_model(curved[0])
    else:
        curves = [key for key in known if key in _DISTORTIONS or key.startswith(("distortionco", "distortionparam"))]
        objection = _objection([number for key in curves for number in _flat(known[key])])
    size = _size_in(known)
    source = known["source"] if known.get("source") in get_args(CameraSource) else "given"
    intrinsics = _intrinsics_in(known, size)
    if isinstance(known.get("roi"), Mapping):
        intrinsics, size = _of_region(known["roi"], intrinsics, size)
    return _Stated(intrinsics, size, source, objection)


def _of_region(
    region: Mapping[str, Any], intrinsics: Intrinsics, size: tuple[int, int] | None
) -> tuple[Intrinsics, tuple[int, int] | None]:
    """Return the camera of the photos, and their size, where ROS's driver sends a window of the sensor.

    ROS's matrix and size are those of the whole sensor, whatever is sent of it (``sensor_msgs/CameraInfo``).
    """
    known = {_plain(key): value for key, value in region.items()}
    left, top, width, height = _numbers([known.get(name, 0) for name in ("xoffset", "yoffset", "width", "height")])
    if width == 0 and height == 0:  # the whole, by convention
        return intrinsics, size
    window = _sides(width, height)
    if size is not None and not (0 <= left <= size[1] - window[1] and 0 <= top <= size[0] - window[0]):
        raise InputError(
            f"its roi, {width:g} x {height:g} pixels at ({left:g}, {top:g}), does not lie in its photos of {size[1]} x "
            f"{size[0]}: correct it, or leave it out"
        )
    return intrinsics.cropped(top, left), window


def _intrinsics_in(known: Mapping[str, Any], size: tuple[int, int] | None) -> Intrinsics:
    for name_x, name_y in _FOCALS:
        if name_x not in known:
            continue
        centre = next((names for names in _CENTRES if names[0] in known and names[1] in known), None)
        if centre is None:
            raise InputError("it has a focal length and no principal point: add cx and cy, in pixels")
        fx, fy, cx, cy = _numbers([known[name_x], known.get(name_y, known[name_x]), *(known[name] for name in centre)])
        half = _HALF if name_x == "flx" else 0.0
        return Intrinsics(fx, fy, cx - half, cy - half)
    for name in _MATRICES:
        if name in known:
            numbers = _flat(known[name])
            if name == "intrinsicmatrix" and len(numbers) == 9 and numbers[2] == numbers[5] == 0:
                numbers = np.reshape(numbers, (3, 3)).T.ravel().tolist()  # Open3D writes it down by columns
            return _of_matrix(numbers)
    if "cameraanglex" in known and size is not None:
        (angle,) = _numbers([known["cameraanglex"]])
        found = Camera.from_fov(size, horizontal=math.degrees(angle)).intrinsics
        if "cx" in known and "cy" in known:
            cx, cy = _numbers([known["cx"], known["cy"]])
            found = replace(found, cx=cx - _HALF, cy=cy - _HALF)
        return found
    raise InputError(
        "it has no camera: neither camera_matrix, K or intrinsics, nor fx, fy, cx and cy, nor fl_x, nor camera_angle_x "
        "with w and h"
    )


def _size_in(known: Mapping[str, Any]) -> tuple[int, int] | None:
    for width, height in _SIDES:
        if width in known and height in known:
            return _sides(*_numbers([known[width], known[height]]))
    for name in _SIDES_IN_ONE:
        if name in known and len(sides := _flat(known[name])) == 2:
            return _sides(*sides)
    if "size" in known and len(sides := _flat(known["size"])) == 2:  # our own: height first
        return _sides(sides[1], sides[0])
    return None


def _sides(width: float, height: float) -> tuple[int, int]:
    if not (1 <= width <= _MAX_SIDE and 1 <= height <= _MAX_SIDE and width == int(width) and height == int(height)):
        raise InputError(f"its photos would have {width:g} x {height:g} pixels, which is nonsense")
    return int(height), int(width)


def _other_model(name: str) -> str:
    return f"has the camera model {name[:40]}, which is not that of a pinhole camera"


def _objection(distortion: Sequence[float]) -> str:
    if not any(number != 0 for number in distortion):
        return ""
    shown = ", ".join(f"{number:g}" for number in distortion[:_MOST_NAMED])
    return f"has lens distortion ({shown}{', ...' * (len(distortion) > _MOST_NAMED)})"


def _of_matrix(values: Any) -> Intrinsics:
    """Return the camera of 3 x 3 numbers, of 4 x 4 around them, or of fx, fy, cx, cy."""
    try:
        matrix = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"its rows of numbers are no camera matrix of 3 x 3 ({str(error)[:80]})") from error
    if matrix.size == 4:
        return Intrinsics(*matrix.ravel().tolist())
    if matrix.shape == (4, 4) and np.array_equal(matrix[3], (0, 0, 0, 1)) and not matrix[:3, 3].any():
        matrix = matrix[:3, :3]
    if matrix.size != 9:
        raise InputError(f"it has numbers of shape {matrix.shape}, and a camera matrix has 3 x 3")
    return Camera.from_matrix(matrix.reshape(3, 3), (1, 1)).intrinsics


def _flat(value: Any) -> list[float]:
    """Return the numbers of a value, of lists in lists, or of a matrix of OpenCV and ROS, with rows, cols and data."""
    if isinstance(value, Mapping):
        return _flat(value["data"] if "data" in value else list(value.values()))
    if isinstance(value, list):
        return [number for item in value for number in _flat(item)]
    return _numbers([value])


def _numbers(words: Sequence[Any]) -> list[float]:
    try:
        return [float(word) for word in words]
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"it has something else where a number belongs ({str(error)[:80]})") from error


def _plain(name: object) -> str:
    """Return a name without signs, in lower case."""
    return "".join(letter for letter in str(name).lower() if letter.isalnum())


_MAX_YAML = 1 << 17  # bytes: the reader of YAML takes seconds for a megabyte

_READERS: dict[str, Callable[[Path, tuple[int, int]], list[_Stated]]] = {
    ".yaml": _read_yaml,
    ".yml": _read_yaml,
    ".json": _read_json,
    ".txt": _read_text,
    ".npy": _read_npy,
}
_HINTS = {
    ".bin": ". COLMAP writes texts, too: colmap model_converter --output_type TXT",
    ".xml": ". OpenCV writes YAML, too: give cv2.FileStorage a name that ends in .yaml",
}
