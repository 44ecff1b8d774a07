"""The camera of a photo as the photo's own notes, its EXIF, tell it."""

import math
from dataclasses import dataclass
from pathlib import Path

from PIL import ExifTags, Image

from zoedepth.claims import BinaryFile
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.sensors import sensor_size
from zoedepth.images import read_photo_notes
from zoedepth.pictures import PhotoNotes, read_notes

_TAGS = ExifTags.Base
_FILM_DIAGONAL = math.hypot(36, 24)  # millimetres, 43.27: the 35-mm equivalent goes by the diagonal (CIPA DCG-001)
_UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of the focal plane -> millimetres; cameras use 4 and 5, too
_INCH = 2  # EXIF's unit where none is said
_MIN_FOV, _MAX_FOV = 1.0, 170.0  # degrees, along the longer side
_MIN_SENSOR, _MAX_SENSOR = 2.9, 100.0  # millimetres of diagonal: below the smallest phone's, above medium format
_MAX_SHAPE = 2.5  # longer by shorter side: what goes beyond was stitched, or is a strip
_MAX_OBLONG = 1.1  # where the two resolutions of a sensor differ more, one of them is wrong: pixels are square
_MAX_OFF_MIDDLE = 0.1  # of a side: lenses look through the middle, where a calibration is of a photo of this size
_MAX_OFF_FILM = 1.25  # makers round the 35-mm equivalent, and some crop after they have measured
_MAX_OFF_SENSOR = 1.25  # the same, for a sensor whose size is known
_MIN_FILM = 9.0  # mm: rectilinear lenses end at 10
_MIN_ZOOM = 1.02  # digital zoom below changes nothing that matters
_SAME_FACTOR = 1.01  # two ways to tell how much a photo was resized agree
_BLOCK = 16  # pixels by which JPEGs are cut without loss: a side shorter by less counts as whole
_APPLE_PANORAMA = 6  # of "CustomRendered"
_SPHERES = ("theta", "insta360", "gear 360", "qoocam")  # cameras that see all round, where XMP was lost


@dataclass(frozen=True)
class ExifCamera:
    """The camera that a photo's notes tell, or the reason why they tell none."""

    camera: Camera | None
    """Pinhole camera of the upright photo, its source "exif"; None where the notes tell none."""
    reason: str
    """The thing that the camera is known by, or the reason why there is none, to be put behind the photo's name and a
    colon: "its 35-mm focal length is 26 mm", "it has no EXIF"."""


class _Unknown(Exception):
    """Raised where notes do not tell the camera: the message says why."""


class _Contradiction(_Unknown):
    """Raised where notes contradict what is known of the camera, so that no other of them can be trusted either."""


class _Unsaid(Exception):
    """Raised where notes say nothing of the kind that is asked for."""


def read_exif_camera(source: str | Path | BinaryFile | Image.Image | PhotoNotes, size: tuple[int, int]) -> ExifCamera:
    """Return the camera that a photo's notes tell, at the size of the upright photo.

    Four things tell it, the first that makes sense: the maker's own calibration in pixels (DJI's drones), where nothing
    else in the notes speaks against it; the focal length in terms of 35-mm film, by the diagonal of the
    photo; the focal length in millimetres with the resolution of the sensor; the same with the size of the sensor,
    where ``sensors`` knows the model. The size that the photo had when it was taken says what became of it since: in
    the same proportions it was resized; with one side left as it was it was cropped, and is taken to look through its
    middle still; otherwise nobody can tell.

    Args:
        source: a path, an open file, a PIL image, or the notes that came with an image.
        size: (height, width) of the photo as it is read: upright.

    Raises:
        InputError: ``source`` is a file that is no picture. Broken notes raise nothing.
    """
    if isinstance(source, Image.Image):
        notes = read_notes(source)
    else:
        notes = source if isinstance(source, PhotoNotes) else read_photo_notes(source)
    try:
        focal, known_by = _focal(notes, size)
    except _Unknown as reason:
        return ExifCamera(None, str(reason))
    return ExifCamera(Camera.from_focal(focal, size, source="exif"), known_by)


def _focal(notes: PhotoNotes, size: tuple[int, int]) -> tuple[float, str]:
    """Return the focal length in pixels of the photo, and what tells it."""
    if not notes.tags:
        raise _Unknown(f"its EXIF is damaged ({notes.damage})" if notes.damage else "it has no EXIF")
    _refuse_other_projections(notes)
    now = (size[1], size[0]) if notes.orientation < 5 else size  # width and height as they are stored
    taken = _size_taken(notes) or now
    if max(taken) > _MAX_SHAPE * min(taken):
        raise _Unknown(f"it has {taken[0]} x {taken[1]} pixels, the shape of a panorama or a strip")
    complaints: list[str] = []
    for tell in (_by_calibration, _by_film, _by_focal_plane, _by_sensor):
        try:
            focal, known_by = tell(notes, taken)
            fov = 2 * math.degrees(math.atan2(max(taken) / 2, focal))
            if not _MIN_FOV <= fov <= _MAX_FOV:
                raise _Unknown(f"{known_by}, a field of view of {fov:.3g} degrees, which is nonsense")
        except _Unsaid:
            continue
        except _Contradiction:
            raise
        except _Unknown as complaint:
            complaints.append(str(complaint))
            continue
        factor, change = _since_taken(taken, now)
        return focal * factor, known_by + change
    raise _Unknown("; ".join(complaints) or "its EXIF does not tell the focal length and what to measure it by")


def _by_calibration(notes: PhotoNotes, taken: tuple[int, int]) -> tuple[float, str]:
    """Return what the maker's calibration says, if something else confirms it.

    Programs that resize a photo copy it as it is, and may change the size that the photo is said to have had.
    """
    if (focal := notes.calibration.get("focal")) is None:
        raise _Unsaid
    known_by = f"its maker's calibration is {focal:.6g} pixels"
    if not 0 < focal < math.inf:
        raise _Unknown(f"{known_by}, which is nonsense")
    if (zoom := _zoom(notes)) > _MIN_ZOOM:
        raise _Unknown(f"{known_by}, without its digital zoom of {zoom:g}")
    middle = notes.calibration.get("x"), notes.calibration.get("y")
    confirmed = False
    for place, side in zip(middle, taken, strict=True):
        if place is not None:
            if not abs(place - side / 2) <= _MAX_OFF_MIDDLE * side:
                raise _Unknown(f"{known_by}, of a photo of another size than {taken[0]} x {taken[1]} pixels")
            confirmed = True
    try:
        by_film, film = _by_film(notes, taken)
    except (_Unsaid, _Unknown):
        pass
    else:
        if not 1 / _MAX_OFF_FILM <= focal / by_film <= _MAX_OFF_FILM:
            raise _Unknown(f"{known_by}, and {film}, which would be {by_film:.6g} pixels")
        confirmed = True
    if not confirmed:
        raise _Unknown(f"{known_by}, which nothing else confirms")
    return focal, known_by


def _by_film(notes: PhotoNotes, taken: tuple[int, int]) -> tuple[float, str]:
    """Return what the 35-mm equivalent says."""
    film = _number(notes, _TAGS.FocalLengthIn35mmFilm, "35-mm focal length", "mm")
    known_by = f"its 35-mm focal length is {film:g} mm"
    zoom = _zoom(notes)
    try:
        lens = _number(notes, _TAGS.FocalLength, "focal length", "mm")
    except (_Unsaid, _Unknown):
        lens = None
    if zoom > _MIN_ZOOM and _text(notes, _TAGS.Make).lower() != "apple":  # Apple's equivalent includes the zoom
        sensor = sensor_size(_text(notes, _TAGS.Make), _text(notes, _TAGS.Model))
        if lens is None or sensor is None:
            raise _Unknown(f"{known_by}, and nobody can tell whether that includes its digital zoom of {zoom:g}")
        beyond = film * math.hypot(*sensor) / (lens * _FILM_DIAGONAL)  # what it has beyond what the lens does
        if max(beyond / zoom, zoom / beyond) < max(beyond, 1 / beyond):
            known_by += ", its digital zoom included"
        else:
            film *= zoom
            known_by += f", times its digital zoom of {zoom:g}"
    if film < _MIN_FILM:
        raise _Unknown(f"{known_by}, shorter than any lens that keeps lines straight")
    sensor = sensor_size(_text(notes, _TAGS.Make), _text(notes, _TAGS.Model))
    # Of a part of the sensor it is longer, and never shorter: some programs give the focal length itself.
    largest = math.inf if sensor is None else _MAX_OFF_SENSOR * math.hypot(*sensor)
    if lens is not None and lens * zoom / film * _FILM_DIAGONAL > largest:
        raise _Unknown(f"{known_by}, too short for a lens of {lens:g} mm and the sensor of this model")
    # Some programs give the equivalent of a small picture of a large sensor, too long by as much as it is smaller.
    if lens is not None and not _MIN_SENSOR <= lens * zoom / film * _FILM_DIAGONAL <= _MAX_SENSOR:
        raise _Unknown(f"{known_by}, which no sensor makes of a lens of {lens:g} mm")
    return film / _FILM_DIAGONAL * math.hypot(*taken), known_by


def _by_focal_plane(notes: PhotoNotes, taken: tuple[int, int]) -> tuple[float, str]:
    """Return what the focal length in millimetres and the resolution of the sensor say."""
    resolution = _resolution(notes)
    lens = _number(notes, _TAGS.FocalLength, "focal length", "mm")
    known_by = f"its focal length is {lens:g} mm, with {resolution:.4g} pixels per mm on its sensor"
    if (zoom := _zoom(notes)) > _MIN_ZOOM:
        raise _Unknown(f"{known_by}, and nobody can tell whether that includes its digital zoom of {zoom:g}")
    diagonal = math.hypot(*taken) / resolution
    if not _MIN_SENSOR <= diagonal <= _MAX_SENSOR:
        raise _Unknown(f"{known_by}, which would be {diagonal:.3g} mm from corner to corner")
    sensor = sensor_size(_text(notes, _TAGS.Make), _text(notes, _TAGS.Model))
    # Programs that make a photo smaller may write its new size, and keep the resolution of the sensor.
    if sensor is not None and not 1 / _MAX_OFF_SENSOR <= diagonal / math.hypot(*sensor) <= _MAX_OFF_SENSOR:
        raise _Contradiction(
            f"{known_by}, which would be {diagonal:.3g} mm from corner to corner, and the sensor of this model has "
            f"{math.hypot(*sensor):.3g}: nobody can tell whether the photo was resized or cropped"
        )
    return lens * resolution, known_by


def _by_sensor(notes: PhotoNotes, taken: tuple[int, int]) -> tuple[float, str]:
    """Return what the focal length in millimetres and the size of the sensor say, where the model is known."""
    make, model = _text(notes, _TAGS.Make), _text(notes, _TAGS.Model)
    sensor = sensor_size(make, model)
    if sensor is None:
        raise _Unsaid
    lens = _number(notes, _TAGS.FocalLength, "focal length", "mm")
    width, height = sensor
    # Of another shape, the photo has the whole of one side of the sensor, and not all of the other.
    resolution = max(max(taken) / width, min(taken) / height)
    known_by = f"its focal length is {lens:g} mm, with the sensor of {width:g} x {height:g} mm of a {model}"
    zoom = max(_zoom(notes), 1.0)
    return lens * resolution * zoom, known_by + (f", times its digital zoom of {zoom:g}" if zoom > _MIN_ZOOM else "")


def _resolution(notes: PhotoNotes) -> float:
    """Return the pixels per millimetre on the sensor."""
    across = _number(notes, _TAGS.FocalPlaneXResolution, "focal plane's resolution", "")
    unit = notes.tags.get(_TAGS.FocalPlaneResolutionUnit, _INCH)
    if not isinstance(unit, int) or unit not in _UNITS:
        raise _Unknown(f"its focal plane's resolution has the unit {_shown(unit)}, which EXIF does not know")
    try:
        down = _number(notes, _TAGS.FocalPlaneYResolution, "focal plane's resolution", "")
    except (_Unsaid, _Unknown):
        down = across
    if not 1 / _MAX_OBLONG <= across / down <= _MAX_OBLONG:
        raise _Unknown(
            f"its focal plane's resolution is {across:.6g} across and {down:.6g} down, and one must be wrong"
        )
    return math.sqrt(across * down) / _UNITS[unit]


def _refuse_other_projections(notes: PhotoNotes) -> None:
    """Refuse what no pinhole camera takes."""
    make, model, lens = (_text(notes, tag).lower() for tag in (_TAGS.Make, _TAGS.Model, _TAGS.LensModel))
    stitched = make == "apple" and notes.tags.get(_TAGS.CustomRendered) == _APPLE_PANORAMA
    if notes.panorama or stitched or any(name in f"{make} {model}" for name in _SPHERES):
        raise _Unknown("it is a panorama, which no pinhole camera takes")
    undistort = "undistort it first, e.g. by cv2.undistort or lensfun, and give the camera of the result"
    if "fisheye" in lens or "fish-eye" in lens:
        raise _Unknown(f"its lens is a fisheye, which bends straight lines: {undistort}")
    if make == "gopro":
        raise _Unknown(f"GoPros bend straight lines unless they are told not to, and EXIF does not tell: {undistort}")


def _size_taken(notes: PhotoNotes) -> tuple[int, int] | None:
    """Return the width and height of the photo as it was taken, pixels; None where that is not said."""
    try:
        sides = [_number(notes, tag, "size", "pixels") for tag in (_TAGS.ExifImageWidth, _TAGS.ExifImageHeight)]
    except (_Unsaid, _Unknown):
        return None
    return (round(sides[0]), round(sides[1])) if min(sides) >= 1 else None


def _since_taken(taken: tuple[int, int], now: tuple[int, int]) -> tuple[float, str]:
    """Return by how much the photo was resized since it was taken, and what is to be said about it."""
    if taken == now:
        return 1.0, ""
    said = f"{taken[0]} x {taken[1]} pixels when it was taken"
    stories = [_story(taken, now)]
    if (taken[0] > taken[1]) != (now[0] > now[1]):  # a program may have turned it, and left its sides as they were said
        stories.append(_story((taken[1], taken[0]), now))
    told = [story for story in stories if story is not None]
    if not told or max(told)[0] > _SAME_FACTOR * min(told)[0]:
        raise _Unknown(f"it has {now[0]} x {now[1]} pixels and had {said}, and nobody can tell how much it was resized")
    factor, became = told[0]
    return factor, f", and it {became} {said}"


def _story(taken: tuple[int, int], now: tuple[int, int]) -> tuple[float, str] | None:
    """Return by how much a photo was resized if it was not turned, and what became of it; None where that cannot be."""
    missing = [before - after for before, after in zip(taken, now, strict=True)]
    inside = min(missing) >= 0
    cropped = 1.0, "was cropped: it had"
    if inside and 0 in missing:
        return cropped
    # The same proportions: a side that is rounded to whole pixels is wrong by less than one.
    if abs(now[0] * taken[1] - now[1] * taken[0]) < sum(taken):
        return math.hypot(*now) / math.hypot(*taken), "had"
    whole = (side < min(_BLOCK, 1 + before // 50) for side, before in zip(missing, taken, strict=True))
    return cropped if inside and any(whole) else None


def _zoom(notes: PhotoNotes) -> float:
    """Return the factor of digital zoom; 1 where none is said."""
    try:
        return _number(notes, _TAGS.DigitalZoomRatio, "digital zoom", "")
    except (_Unsaid, _Unknown):  # 0 is EXIF's way to say that there was none
        return 1.0


def _number(notes: PhotoNotes, tag: int, what: str, unit: str) -> float:
    """Return a positive number of the notes."""
    if (value := notes.tags.get(tag)) is None:
        raise _Unsaid
    if isinstance(value, tuple) and len(value) == 1:
        value = value[0]
    try:
        # EXIF's values are of any type: what is no number raises.
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        number = math.nan
    if not 0 < number < math.inf:
        raise _Unknown(f"its {what} is {_shown(value)}{' ' * bool(unit)}{unit}, which is nonsense")
    return number


def _shown(value: object) -> str:
    """Return a value that anybody may have written, short and in one line."""
    return ascii(value)[:40] if isinstance(value, str | bytes | tuple) else str(value)[:40]


def _text(notes: PhotoNotes, tag: int) -> str:
    """Return a short text of the notes; empty where there is none."""
    value = notes.tags.get(tag)
    return value.strip("\0 ")[:100] if isinstance(value, str) else ""
