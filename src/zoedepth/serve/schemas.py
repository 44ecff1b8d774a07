"""Requests and answers as OpenAPI describes them. FastAPI checks every query against these."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from zoedepth.calibration import Calibration
from zoedepth.calibration.calibration import MAX_FILE
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.choice import CameraChoice
from zoedepth.geometry.lens import Lens
from zoedepth.outputs import Options
from zoedepth.serve.answers import NAMES
from zoedepth.serve.engine import Wanted
from zoedepth.serve.problems import Problem
from zoedepth.stored import parse_json

MAX_POINTS = 1000
"""Points, pairs and readings of a request, at most."""

_NUMBER = r"-?\d{1,7}(\.\d{1,12})?"
_Degrees = Annotated[float, Field(ge=2.8, le=160)]  # in radians all lenses have less
_Metres = Annotated[float, Field(ge=1e-6, le=1e6)]
_Side = Annotated[float, Field(ge=-1e7, le=1e7)]
_Pixel = tuple[_Side, _Side]
_Flag = Literal["true", "false"]


class PredictionQuery(BaseModel):
    """The way in which a photo is predicted: the options of `zoedepth predict`."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    model: str | None = Field(None, max_length=200, description="Name of a model of /v1/models; without it, the first.")
    domain: str | None = Field(
        None, max_length=200, description="Scene type whose head to use; without it, the model's router decides."
    )
    camera: Literal["exif", "none"] | None = Field(
        None, description="exif, the default, reads the camera from the photo's notes; none asks nobody."
    )
    fov_x: _Degrees | None = Field(None, description="Field of view, degrees from the left to the right border.")
    fov_y: _Degrees | None = Field(None, description="Field of view, degrees from the top to the bottom border.")
    fov_diagonal: _Degrees | None = Field(None, description="Field of view, degrees from corner to corner.")
    focal_px: Annotated[float, Field(ge=0.01, lt=1e7)] | None = Field(
        None, description="Focal length in pixels of the photo."
    )
    intrinsics: str | None = Field(
        None,
        pattern=rf"^{_NUMBER}(,{_NUMBER}){{3}}$",
        description="FX,FY,CX,CY: focal lengths and principal point in pixels; the top left pixel's centre is at 0,0.",
    )
    focal_correction: Literal["model", "yes", "no"] = Field(
        "model", description="Multiply depth by the photo's focal length over that of the training photos."
    )
    flip: _Flag = Field(
        "true", description="Average with the prediction for the mirrored photo: smoother, half as fast."
    )

    def wanted(self) -> Wanted:
        """Return the query as the engine takes it.

        Raises:
            InputError: several fields say the camera, or one has a value that no camera has.
        """
        corrections = {"model": None, "yes": True, "no": False}
        return Wanted(self.model, self.domain, self._camera(), self.flip == "true", corrections[self.focal_correction])

    def _camera(self) -> CameraChoice:
        names = ("camera", "fov_x", "fov_y", "fov_diagonal", "focal_px", "intrinsics")
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) > 1:
            raise InputError(f"{' and '.join(given)} each say the camera: give one of them")
        if self.intrinsics is not None:
            fx, fy, cx, cy = map(float, self.intrinsics.split(","))
            if min(fx, fy) <= 0:
                raise InputError("the focal lengths of intrinsics must be above 0")
            return Intrinsics(fx, fy, cx, cy)
        if not given or self.camera is not None:
            return self.camera or "exif"
        return Lens(fov_x=self.fov_x, fov_y=self.fov_y, fov_diagonal=self.fov_diagonal, focal_px=self.focal_px)


class CalibratedQuery(PredictionQuery):
    """A query whose metres may be put right."""

    calibration_scale: Annotated[float, Field(ge=1e-4, le=1e4)] | None = Field(
        None, description="Factor of all depths; in place of the part calibration."
    )

    def calibration(self, part: bytes | None) -> Calibration | None:
        """Return the calibration of a request: that of its part, or the factor of its query; None without either.

        Raises:
            InputError: both are given, or the part is no calibration.
        """
        if part is None:
            return None if self.calibration_scale is None else Calibration(self.calibration_scale)
        if self.calibration_scale is not None:
            raise InputError("the part calibration and calibration_scale both put the metres right: give one of them")
        values = parse_json(part, "the part calibration", max_bytes=MAX_FILE)
        inner = values.get("calibration")
        if values.get("zoedepth") != "calibration" or not isinstance(inner, dict):
            raise InputError("the part calibration is no file of `zoedepth calibrate` or /v1/calibrate")
        return Calibration.from_json(inner, where="the part calibration")


class DepthQuery(CalibratedQuery):
    """The query of /v1/depth."""

    # pydantic makes the choices of a tuple, which a type checker cannot know.
    format: Literal[NAMES] | None = Field(  # pyright: ignore[reportInvalidTypeForm]
        None, description="Format of the answer; without it, that of the header Accept, else png."
    )
    png_scale: Annotated[float, Field(ge=1e-6, le=1e6)] | None = Field(
        None, description="Levels per metre of a PNG; without it 1000 (millimetres), or 256 beyond 65.535 m."
    )
    vmin: Annotated[float, Field(ge=0, le=1e6)] | None = Field(
        None, description="Metres of the first colour of preview and color."
    )
    vmax: Annotated[float, Field(ge=1e-6, le=1e6)] | None = Field(
        None, description="Metres of the last colour of preview and color."
    )
    colormap: Literal[
        "magma", "magma_r", "turbo", "turbo_r", "gray", "gray_r", "Spectral", "Spectral_r"
    ] = Field("magma_r", description="Colours of preview and color.")  # fmt: skip
    max_triangles: Annotated[int, Field(ge=1, le=10_000_000)] = Field(
        500_000, description="Triangles of a mesh (glb, usdz, html), at most."
    )
    max_depth: Annotated[float, Field(ge=1e-3, le=1e6)] | None = Field(
        None, description="Metres beyond which a pixel makes no point and no surface, as for the sky."
    )

    def options(self) -> Options:
        """Return how the file of the answer is written.

        Raises:
            InputError: the values do not go together.
        """
        return Options(self.png_scale, self.vmin, self.vmax, self.colormap, self.max_triangles, self.max_depth)


class CalibrationQuery(PredictionQuery):
    """The query of /v1/calibrate."""

    form: Literal["scale", "scale-shift"] = Field(
        "scale", description="scale-shift also fits a power of the depth where the readings say that it helps."
    )
    along_ray: _Flag = Field(
        "false",
        description="Readings are from the lens to the thing, as a tape measure gives them, not along the axis. The "
        "camera must be known for it, from the photo or the query.",
    )


class CameraAnswer(BaseModel):
    """A pinhole camera; the centre of the top left pixel is at (0, 0)."""

    size: tuple[int, int] = Field(description="Height and width of the photo, pixels.")
    fx: float
    fy: float
    cx: float
    cy: float
    source: Literal["given", "exif", "assumed"] = Field(description="Who says it; assumed: nobody.")


class Spread(BaseModel):
    """Depth in metres, summed up."""

    min: float
    median: float
    max: float


class About(BaseModel):
    """Facts about a depth map."""

    model: str
    input_size: tuple[int, int] = Field(description="Height and width of the photo and of the depth.")
    network_size: tuple[int, int] = Field(description="Height and width at which the model saw the photo.")
    domain: str = Field(description="Scene type whose head made the depth.")
    domain_probability: dict[str, float]
    camera: CameraAnswer
    camera_note: str = Field(description="The photo's notes on its camera, or why they tell none.")
    focal_correction: float = Field(description="Factor that depth and std were multiplied by because of the camera.")
    calibration: dict[str, Any] | None = Field(description="The calibration that the depth went through.")
    depth_range: tuple[float, float | None] = Field(
        description="Metres: nearest and farthest depth that the model gives; null: there is no farthest."
    )
    unit: Literal["metre"]
    depth: Spread
    median_confidence: float | None
    notes: list[str] = Field(description="Sentences about the photo: that it is nearly black, a panorama, ...")
    zoedepth: str = Field(description="Version of the service.")


class MeasuredPoint(BaseModel):
    """The depth at a pixel."""

    x: float
    y: float
    depth: float | None = Field(description="Metres along the optical axis; null where the depth cannot be relied on.")
    std: float | None = Field(description="Metres: ± of the depth by the model's own distribution.")
    reason: str | None = Field(description="Why there is no depth.")


class MeasuredPair(BaseModel):
    """The distance in space between what two pixels see."""

    points: tuple[tuple[float, float], tuple[float, float]]
    distance: float | None = Field(description="Metres; null where the depth at one of them cannot be relied on.")
    reason: str | None = Field(description="Why there is no distance.")


class Measured(BaseModel):
    """The answer of /v1/measure."""

    points: list[MeasuredPoint]
    pairs: list[MeasuredPair]
    about: About


class CalibrationAnswer(BaseModel):
    """A calibration: the file that `zoedepth predict --calibration` and the part calibration take."""

    zoedepth: Literal["calibration"] = "calibration"
    calibration: dict[str, Any]


class ModelAnswer(BaseModel):
    """A model that can be chosen."""

    name: str
    domains: list[str]
    size: tuple[int, int] = Field(description="Height and width that it was trained at.")
    what: str | None = Field(description="Purpose.")
    licence: str | None = Field(description="Licence of the weights; null: nobody says it.")
    trained_on: str | None = Field(description="Training data, with its terms.")


class FormatAnswer(BaseModel):
    """A format of answers."""

    name: str
    media_type: str
    ending: str
    summary: str
    aliases: list[str] = Field(description="Other words for it in ?format=.")
    needs: str | None = Field(description="Module that writes it, where the package can do without.")
    available: bool = Field(description="True where all is installed that it needs.")


class LimitsAnswer(BaseModel):
    """Limits of a request."""

    max_body: int = Field(description="Bytes.")
    max_pixels: int
    queue: int
    max_wait: float = Field(description="Seconds.")
    max_seconds: float = Field(description="Seconds.")


class ModelsAnswer(BaseModel):
    """The answer of /v1/models."""

    default: str
    models: list[ModelAnswer]
    formats: list[FormatAnswer]
    photo_types: list[str] = Field(description="Media types of photos that are taken.")
    limits: LimitsAnswer


class State(BaseModel):
    """The answer of /healthz and /readyz."""

    status: Literal["ok"] = "ok"


class ProblemAnswer(BaseModel):
    """Problem details, RFC 9457."""

    type: str
    title: str
    status: int
    detail: str
    errors: list[dict[str, str]] | None = Field(None, description="What is wrong with each parameter.")


_POINTS = TypeAdapter(Annotated[list[_Pixel], Field(max_length=MAX_POINTS)])
_PAIRS = TypeAdapter(Annotated[list[tuple[_Pixel, _Pixel]], Field(max_length=MAX_POINTS)])
_READINGS = TypeAdapter(Annotated[list[tuple[_Side, _Side, _Metres]], Field(max_length=MAX_POINTS)])
_DISTANCES = TypeAdapter(Annotated[list[tuple[_Pixel, _Pixel, _Metres]], Field(max_length=MAX_POINTS)])

LISTS: dict[str, tuple[TypeAdapter[Any], str]] = {
    "points": (_POINTS, "[[x, y], ...]"),
    "pairs": (_PAIRS, "[[[x, y], [x, y]], ...]"),
    "readings": (_READINGS, "[[x, y, metres], ...]"),
    "distances": (_DISTANCES, "[[[x, y], [x, y], metres], ...]"),
}
"""Name of a part that is a list in JSON → its type, and how it is written."""


def parse_list(name: str, content: bytes | None) -> list[Any]:
    """Return the list in a part of a form; empty where there is no such part.

    Raises:
        Problem: it is no such list.
    """
    if content is None:
        return []
    adapter, form = LISTS[name]
    try:
        return adapter.validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = "".join(f"[{place}]" for place in first["loc"])
        raise Problem(
            "invalid-request",
            f"The part {name} must be JSON as {form}, of at most {MAX_POINTS}: {where} {first['msg']}",
        ) from error
