"""A page for the browser, in one file, on which a mesh or a cloud can be turned: it needs no server and no network.

The page holds the file itself, as another program would open it, and three.js, which shows it (``assets/viewer``).
"""

import base64
import html
import json
from importlib.resources import files
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from zoedepth.errors import InputError
from zoedepth.images import OWN_MARK, atomic_path
from zoedepth.outputs.cloud import AXES, Cloud, cloud_of
from zoedepth.outputs.glb import GLB
from zoedepth.outputs.output import Maps, Options, Output, Written
from zoedepth.outputs.ply import write_ply
from zoedepth.stored import readable

MAX_FILE = 1 << 28
"""Bytes of the largest file that a page can hold: browsers take no longer texts."""

Kind = Literal["glb", "ply", "pcd"]
Up = Literal["y", "-y", "z"]
Place = Literal["photo", "around", "outside"]

_KINDS: dict[str, Kind] = {".glb": "glb", ".ply": "ply", ".pcd": "pcd"}
_STARTS: dict[Kind, tuple[bytes, ...]] = {"glb": (b"glTF",), "ply": (b"ply",), "pcd": (b"# .PCD", b"VERSION")}
_HEAD = 4096  # bytes in which all that we say of ourselves stands, but for the camera of a mesh


def write_page(path: str | Path, content: bytes, *, kind: Kind, title: str, up: Up = "y", place: Place) -> None:
    """Write a page that shows a file of a mesh or a cloud, and turns it.

    The page may load nothing from anywhere, whatever the file asks for.

    Args:
        path: where to write; missing folders are made.
        content: the file.
        kind: its format.
        title: said above the picture.
        up: the direction in the file that is up in the world: "y", as in glTF, "-y", as in OpenCV, or "z".
        place: where the first look is from: "photo", from the origin, as the photo; "around", from the origin, around
            which all lies; "outside", from where all is seen.

    Raises:
        InputError: the page would be longer than browsers take.
    """
    if len(content) > MAX_FILE:
        raise InputError(
            f"{path} would hold {len(content):,} bytes, and a page can hold {MAX_FILE:,}: take fewer triangles or "
            "points (--max-triangles, --max-points)"
        )
    folder = files("zoedepth") / "assets" / "viewer"
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in ("page.html", "three.min.js", "viewer.js")}
    facts = json.dumps({"kind": kind, "up": up, "place": place})
    page = Template(texts["page.html"]).substitute(
        mark=OWN_MARK,
        title=html.escape(readable(title)),
        facts=facts,
        content=base64.b64encode(content).decode("ascii"),
        three=texts["three.min.js"],
        viewer=texts["viewer.js"],
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def write_page_of_file(path: str | Path, file: str | Path, *, up: Up | None = None) -> None:
    """Write a page that shows a GLB, a PLY or a PCD, of any program.

    Args:
        path: where to write; missing folders are made.
        file: the mesh or cloud.
        up: the direction in the file that is up. None: the files of this package say it; in others it is y.

    Raises:
        InputError: the file is missing, too large, or of another kind.
    """
    file = Path(file)
    kind = _KINDS.get(file.suffix.lower())
    if kind is None:
        raise InputError(f"{file} is no mesh or cloud that a page can show: give a .glb, .ply or .pcd")
    try:
        n_bytes = file.stat().st_size
        content = file.read_bytes() if n_bytes <= MAX_FILE else b""
    except OSError as error:
        raise InputError(f"{file} cannot be opened: {error.strerror}; check the path") from error
    if n_bytes > MAX_FILE:
        raise InputError(f"{file} has {n_bytes:,} bytes, and a page can hold {MAX_FILE:,}: make it smaller first")
    if not content.startswith(_STARTS[kind]):
        raise InputError(f"{file} does not begin as a .{kind} does: check what it is")
    own_up, place = _seen_from(content, kind)
    write_page(path, content, kind=kind, title=file.name, up=up or own_up, place=place)


def write_page_of_maps(
    path: str | Path, maps: Maps, *, title: str, cloud: bool = False, most: int | None = None
) -> Written:
    """Write a page that shows the depth of a photo, first from where the photo was taken.

    Args:
        path: where to write; missing folders are made.
        maps: the maps of a photo.
        title: said above the picture.
        cloud: True shows points, False the surface.
        most: triangles of the surface, or points of the cloud, at most; None keeps all.

    Raises:
        InputError: there is no depth, or nothing to make points or a surface of.
        MissingExtraError: fast-simplification is not installed.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "content"
        if cloud:
            points = cloud_of(maps)
            points = points if most is None else _thinned(points, most)
            write_ply(file, points)
            written = Written({"points": len(points.points)})
        else:
            written = GLB.write(file, maps, Options(max_triangles=most))
        place: Place = "around" if maps.panorama else "photo"
        kind: Kind = "ply" if cloud else "glb"
        write_page(path, file.read_bytes(), kind=kind, title=title, up="-y" if cloud else "y", place=place)
    return written


def _thinned(cloud: Cloud, most: int) -> Cloud:
    """Return some of the points, at random, so that they make no pattern; the same ones every time."""
    if len(cloud.points) <= most:
        return cloud
    some = np.sort(np.random.default_rng(0).choice(len(cloud.points), most, replace=False))
    points, colors, normals = (None if column is None else column[some] for column in cloud)
    assert points is not None
    return Cloud(points, colors, normals)


def _seen_from(content: bytes, kind: Kind) -> tuple[Up, Place]:
    """Return what is up in a file, and where the first look is from: files of this package say where the camera was."""
    head = content[:_HEAD]
    if OWN_MARK.encode() not in head:
        return "y", "outside"
    if kind == "glb":
        length = int.from_bytes(content[12:16], "little")  # of the description, which stands before the numbers
        return "y", "photo" if b'"cameras":[' in content[20 : 20 + length] else "around"
    if AXES.encode() not in head:
        return "y", "outside"
    return "-y", "photo" if b"camera of the photo" in head else "around"


def _write(path: Path, maps: Maps, options: Options) -> Written:
    return write_page_of_maps(path, maps, title="A photo in three dimensions", most=options.max_triangles)


HTML = Output(".html", "a page on which the surface can be turned, for the browser", _write, suffixes=(".html",))
