"""``zoedepth view``: a photo, a mesh or a cloud in three dimensions, on a page for the browser."""

import webbrowser
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from zoedepth.errors import InputError
from zoedepth.outputs import Options
from zoedepth.outputs.html import write_page_of_file, write_page_of_maps
from zoedepth.outputs.ownership import require_own_mark

_FILES = (".glb", ".ply", ".pcd")


def view(
    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PHOTO|FILE")],
    *,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    cloud: bool = False,
    panorama: bool = False,
    max_triangles: int = 200_000,
    max_points: int = 500_000,
    max_depth: float | None = None,
    up: Literal["y", "-y", "z"] | None = None,
    model: str = "zoed-lite",
    domain: str | None = None,
    camera: Annotated[str | None, tyro.conf.arg(metavar="exif|none|FILE")] = None,
    fov_x: float | None = None,
    fov_y: float | None = None,
    fov_diagonal: float | None = None,
    focal_px: float | None = None,
    intrinsics: Annotated[tuple[float, float, float, float] | None, tyro.conf.arg(metavar="FX FY CX CY")] = None,
    device: str = "auto",
    open_: Annotated[bool, tyro.conf.arg(name="open")] = False,
) -> int:
    """Write a page for the browser, on which a photo, a mesh or a cloud can be turned in three dimensions.

    The page is one file that needs no server and no network: open it, or send it to somebody.

    Args:
        source: a photo, whose depth is predicted; or a mesh or cloud of any program: a .glb, .ply or .pcd.
        out: page to write; without it, NAME.html in this folder.
        cloud: show the photo as points, and not as a surface.
        panorama: the photo is a panorama of 360 x 180 degrees, twice as wide as high. One that says so in its XMP is
            found to be one without this.
        max_triangles: triangles of a photo's surface, at most.
        max_points: points of a photo's cloud, at most.
        max_depth: metres beyond which a photo's pixels are not shown, as for the sky.
        up: the direction in a FILE that is up: y, -y (OpenCV's axes) or z. Files of `zoedepth predict` say it; in
            others it is y, if this is not given.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or a file of
            `zoedepth export`.
        domain: scene type whose head to use, e.g. indoor; without it the model's router decides.
        camera: exif, the default, reads the camera from the photo's notes. none assumes it. FILE is a camera.
        fov_x: field of view, degrees from the left to the right border.
        fov_y: field of view, degrees from the top to the bottom border.
        fov_diagonal: field of view, degrees from corner to corner.
        focal_px: focal length in pixels.
        intrinsics: focal lengths and principal point in pixels.
        device: cpu, cuda, mps, or auto for the best there is; zoed-lite runs on the CPU where no driver of an
            accelerator is found.
        open_: show the page in the browser of this machine at once.
    """
    page = out or Path(f"{source.stem}.html")
    if page.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out {page} must be a page, with a name that ends in .html")
    require_own_mark(page, advice="give another name (--out)")
    if source.suffix.lower() in _FILES:
        if cloud or panorama or max_depth is not None:
            raise InputError(
                f"--cloud, --panorama and --max-depth are for photos, and {source} is shown as it is: leave them out"
            )
        write_page_of_file(page, source, up=up)
        return _tell(page, show=open_)
    if up is not None:
        raise InputError("--up is for files of meshes and clouds; photos are shown upright: leave it out")
    if max_triangles < 1 or max_points < 1:
        raise InputError("--max-triangles and --max-points must be 1 or more")
    options = Options(max_depth=max_depth)

    from zoedepth.commands.cameras import chosen_camera
    from zoedepth.commands.progress import download_progress
    from zoedepth.panorama import is_sphere, predict_panorama
    from zoedepth.predict import Predictor
    from zoedepth.weights.load import load_for_prediction

    known_camera = chosen_camera(
        [source],
        camera=camera,
        fov_x=fov_x,
        fov_y=fov_y,
        fov_diagonal=fov_diagonal,
        focal_px=focal_px,
        intrinsics=intrinsics,
    )
    panorama = panorama or is_sphere(source)
    if panorama and not isinstance(known_camera, str):
        raise InputError("a panorama looks everywhere and has no camera: leave the camera out")
    with download_progress() as progress:
        network = load_for_prediction(model, device=device, progress=progress)
    if not network.config.domains:
        raise InputError(f"{model} gives relative depth, which makes no shape: choose a model of metres")
    predictor = Predictor(network, device=device, camera=known_camera)
    if panorama:
        maps = predict_panorama(predictor, source, domain=domain).maps
    else:
        maps = predictor(source, domain=domain).maps
    maps = maps.up_to(options.max_depth)
    write_page_of_maps(page, maps, title=source.name, cloud=cloud, most=max_points if cloud else max_triangles)
    return _tell(page, show=open_)


def _tell(page: Path, *, show: bool) -> int:
    size = f"{page.stat().st_size / 1e6:.1f} MB"
    shown = show and webbrowser.open(page.resolve().as_uri())
    advice = "" if shown else "No browser was found here: open it elsewhere." if show else "Open it in a browser."
    Console(highlight=False).print(f"Page: {page} ({size}). {advice}".rstrip(), soft_wrap=True, markup=False)
    return 0
