"""The application: addresses, their documentation, and what each of them does."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Annotated, Any, TypeVar

from fastapi import FastAPI, Query
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from zoedepth import __version__
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.serve import metrics as prometheus
from zoedepth.serve.answers import FORMATS, NOTES, File, about, choose_format, dump, encode
from zoedepth.serve.body import PHOTO, read_parts
from zoedepth.serve.description import INTRODUCTION, body_of, describe_names, photo_answers, problem_answers
from zoedepth.serve.engine import Engine, Model, Times, told
from zoedepth.serve.guard import BEGAN, Guard, Receive, Scope, Send
from zoedepth.serve.metrics import Metrics
from zoedepth.serve.page_files import PageFile, read_page
from zoedepth.serve.photos import MEDIA_TYPES, Decoded, hear_warnings
from zoedepth.serve.problems import GONE, ClientGone, Problem
from zoedepth.serve.protocol import CLOSE, IDLE
from zoedepth.serve.schemas import (
    CalibratedQuery,
    CalibrationAnswer,
    CalibrationQuery,
    DepthQuery,
    Measured,
    ModelsAnswer,
    PredictionQuery,
    State,
    parse_list,
)
from zoedepth.serve.settings import Settings
from zoedepth.weights.releases import RELEASES

Result = TypeVar("Result")


class Service:
    """The service as an ASGI application, for any server: see ``create_app``."""

    def __init__(self, guard: Guard, engine: Engine) -> None:
        self._guard, self._engine = guard, engine

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request; at the beginning of the lifespan load the models.

        What is wrong with a model is told to the server in a sentence: a traceback tells nobody what to do.
        """
        if scope["type"] == "lifespan":
            try:
                await asyncio.get_running_loop().run_in_executor(None, self.load)
            except ZoeDepthError as error:
                await receive()
                await send({"type": "lifespan.startup.failed", "message": str(error)})
                return
        await self._guard(scope, receive, send)

    def load(self) -> None:
        """Load the models now, and not when the lifespan begins.

        Raises:
            InputError: a model cannot be loaded.
        """
        self._engine.start()

    def close(self) -> None:
        """Begin nothing new: refuse what comes, and what waits. What is computed is finished."""
        self._guard.close()

    @property
    def is_computing(self) -> bool:
        """True while threads compute something."""
        return self._engine.is_computing


def create_app(settings: Settings | None = None) -> Service:
    """Make the service as an ASGI application. The models are loaded when its lifespan begins.

    Args:
        settings: models, devices, clients and limits; None takes the defaults.
    """
    settings = settings or Settings()
    metrics = Metrics()
    engine = Engine(settings, metrics)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[dict[str, object]]:
        with hear_warnings():
            yield {CLOSE: guard.close, IDLE: settings.limits.idle}
        engine.stop()

    app = FastAPI(
        title="ZoeDepth",
        version=__version__,
        description=INTRODUCTION,
        lifespan=lifespan,
        docs_url=None,  # these pages come from another host
        redoc_url=None,
        redirect_slashes=False,
        responses=problem_answers(),
    )
    _add_handlers(app)
    _add_calls(app, engine, settings)
    _add_checks(app, engine, metrics)
    for path, file in read_page().items():
        app.router.routes.append(Route(path, _page_file(file), methods=["GET"], include_in_schema=False))
    described = app.openapi
    app.openapi = lambda: describe_names(
        described(), {name: model.domains for name, model in engine.models.items()}, secret=settings.token is not None
    )
    inner: Any = app
    if settings.origins:
        inner = CORSMiddleware(
            app,
            allow_origins=settings.origins,
            allow_methods=["GET", "POST"],
            allow_headers=["authorization", "content-type"],
            expose_headers=["server-timing", "retry-after", "content-disposition", NOTES],
        )
    guard = Guard(inner, settings, metrics, admit=engine.admit, on_close=engine.close)
    return Service(guard, engine)


def _add_calls(app: FastAPI, engine: Engine, settings: Settings) -> None:
    """Add the addresses below /v1."""

    async def compute(
        request: Request,
        query: PredictionQuery,
        parts: Mapping[str, bytes],
        finish: Callable[[DepthMap, Decoded], Result],
    ) -> tuple[Result, Times]:
        with told():
            wanted = query.wanted()
        gone: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        watcher = asyncio.ensure_future(_watch(request, gone))
        try:
            return await engine.compute(parts[PHOTO], wanted, finish, gone=gone, began=request.scope[BEGAN])
        finally:
            watcher.cancel()
            gone.cancel()  # whatever has not begun for this request shall not begin

    def named(query: PredictionQuery) -> Model:
        return engine.model(query.wanted())

    @app.post(
        "/v1/depth",
        summary="Depth of a photo",
        operation_id="depth",
        response_class=Response,
        responses=photo_answers(),
        openapi_extra=body_of("calibration", raw=True),
    )
    async def depth(request: Request, query: Annotated[DepthQuery, Query()]) -> Response:
        """Return the depth in metres of a photo, as a file in the format that is asked for."""
        with told():
            options, model = query.options(), named(query)
            wanted = choose_format(query.format, request.headers.get("accept"))
        parts = await read_parts(request, (PHOTO, "calibration"))
        put_right = _calibrated(query, parts, model)

        def finish(result: DepthMap, photo: Decoded) -> File:
            return encode(put_right(result), photo, wanted, options, model=model.name)

        file, times = await compute(request, query, parts, finish)
        headers = {"content-disposition": f'attachment; filename="photo{wanted.ending}"'}
        if file.notes:
            headers[NOTES] = "; ".join(file.notes)
        return _answer(file.content, times, wanted.media_type, headers)

    @app.post(
        "/v1/measure",
        summary="Metres at points of a photo",
        operation_id="measure",
        response_model=Measured,
        openapi_extra=body_of("points", "pairs", "calibration"),
    )
    async def measure(request: Request, query: Annotated[CalibratedQuery, Query()]) -> Response:
        """Return the depth at points of a photo, and the distance in space between the points of pairs."""
        with told():
            model = named(query)
        parts = await read_parts(request, (PHOTO, "points", "pairs", "calibration"))
        points, pairs = parse_list("points", parts.get("points")), parse_list("pairs", parts.get("pairs"))
        put_right = _calibrated(query, parts, model)

        def finish(result: DepthMap, photo: Decoded) -> bytes:
            result = put_right(result)
            values = {
                "points": [_point(result, *point) for point in points],
                "pairs": [_pair(result, *pair) for pair in pairs],
                "about": about(result, photo, model=model.name, facts={}),
            }
            return dump(values)

        return _answer(*await compute(request, query, parts, finish))

    @app.post(
        "/v1/calibrate",
        summary="Metres put right by readings",
        operation_id="calibrate",
        response_model=CalibrationAnswer,
        openapi_extra=body_of("readings", "distances"),
    )
    async def calibrate(request: Request, query: Annotated[CalibrationQuery, Query()]) -> Response:
        """Return the calibration that brings the depth of a photo to what was measured: see `zoedepth calibrate`."""
        with told():
            model = named(query)
        parts = await read_parts(request, (PHOTO, "readings", "distances"))
        readings = [*parse_list("readings", parts.get("readings"))]
        distances = [*parse_list("distances", parts.get("distances"))]

        def finish(result: DepthMap, photo: Decoded) -> bytes:
            along_ray = query.along_ray == "true"
            found = result.find_calibration([*readings, *distances], along_ray=along_ray, form=query.form)
            found = replace(found, network=model.told, weights=model.weights)
            return dump({"zoedepth": "calibration", "calibration": found.to_json()})

        return _answer(*await compute(request, query, parts, finish))

    @app.get("/v1/models", summary="Models, formats and limits", operation_id="models", response_model=ModelsAnswer)
    async def models() -> Response:
        """Return the models that can be chosen, the formats of answers, and the limits of a request."""
        limits = settings.limits
        values = {
            "default": next(iter(engine.models)),
            "models": [_describe(model) for model in engine.models.values()],
            "formats": [{**vars(known), "available": known.available} for known in FORMATS.values()],
            "photo_types": list(MEDIA_TYPES.values()),
            "limits": {
                name: getattr(limits, name) for name in ("max_body", "max_pixels", "queue", "max_wait", "max_seconds")
            },
        }
        return _json(values)


def _add_checks(app: FastAPI, engine: Engine, metrics: Metrics) -> None:
    """Add what watches over the service."""

    @app.get("/healthz", summary="Is the process alive?", operation_id="healthz", response_model=State)
    async def healthz() -> Response:
        """Return ok while the process answers at all."""
        return _json({"status": "ok"})

    @app.get("/readyz", summary="Is it ready for photos?", operation_id="readyz", response_model=State)
    async def readyz() -> Response:
        """Return ok while photos are taken, and 503 while the service starts or shuts down."""
        if not engine.ready:
            raise Problem("shutting-down", "The service does not take photos now.")
        return _json({"status": "ok"})

    @app.get(
        "/metrics",
        summary="Numbers for Prometheus",
        operation_id="metrics",
        response_class=Response,
        responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
    )
    async def numbers() -> Response:
        """Return counters and histograms in the text format of Prometheus."""
        return Response(metrics.text(), headers={"content-type": prometheus.MEDIA_TYPE, "cache-control": "no-store"})


def _add_handlers(app: FastAPI) -> None:
    """Let every error be told as problem details."""

    @app.exception_handler(Problem)
    async def problem(request: Request, error: Problem) -> Response:
        return _refusal(error)

    @app.exception_handler(ClientGone)
    async def nobody_waits(request: Request, error: ClientGone) -> Response:
        return Response(status_code=GONE)

    @app.exception_handler(HTTPException)
    async def no_route(request: Request, error: HTTPException) -> Response:
        if error.status_code == 405:
            detail = f"{request.method} does not work here; OpenAPI at /openapi.json says what does."
            return _refusal(Problem("wrong-method", detail, headers=error.headers))
        return _refusal(Problem("not-found", "There is nothing at this address; OpenAPI is at /openapi.json."))

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        found = [f"{'.'.join(map(str, each['loc'][1:]))}: {each['msg']}" for each in error.errors()]
        return _refusal(Problem("invalid-request", f"The query is wrong: {'; '.join(found[:10])}."))

    @app.exception_handler(Exception)
    async def fault(request: Request, error: Exception) -> Response:
        return _refusal(Problem("internal-error", "This is a fault of the service, and is in its log."))


def _calibrated(query: CalibratedQuery, parts: Mapping[str, bytes], model: Model) -> Callable[[DepthMap], DepthMap]:
    """Return the function that puts the metres of a depth map right, if the request asks for that."""
    with told():
        calibration = query.calibration(parts.get("calibration"))
    if calibration is None:
        return lambda result: result
    if query.calibration_scale is not None:  # a bare factor holds for whatever it is applied to
        return lambda result: result.calibrated(replace(calibration, focal_corrected=result.focal_correction != 1))
    # The command line knows a model by what follows --model; older calibrations know it by what it is called here.
    network = model.name if calibration.network == model.name else model.source

    def put_right(result: DepthMap) -> DepthMap:
        try:
            return result.calibrated(calibration, network=network, weights=model.weights)
        except InputError as error:  # where the model lies is no business of a client
            raise InputError(str(error).replace(model.source, model.told)) from None

    return put_right


def _point(result: DepthMap, x: float, y: float) -> dict[str, object]:
    _check_inside(result, x, y)
    try:
        depth, std = result.at(x, y)
    except InputError as error:
        return {"x": x, "y": y, "depth": None, "std": None, "reason": str(error)}
    return {"x": x, "y": y, "depth": depth, "std": std, "reason": None}


def _pair(result: DepthMap, one: tuple[float, float], other: tuple[float, float]) -> dict[str, object]:
    _check_inside(result, *one)
    _check_inside(result, *other)
    try:
        return {"points": [one, other], "distance": result.measure(one, other), "reason": None}
    except InputError as error:
        return {"points": [one, other], "distance": None, "reason": str(error)}


def _check_inside(result: DepthMap, x: float, y: float) -> None:
    height, width = result.size
    if not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):
        raise InputError(f"the point {x:g}, {y:g} is outside the photo of {width} x {height} pixels")


def _describe(model: Model) -> dict[str, object]:
    provenance = model.network.provenance
    release = RELEASES.get(model.source)
    return {
        "name": model.name,
        "domains": model.domains,
        "size": model.network.config.size,
        "what": None if release is None else release.what,
        "licence": provenance.licence if release is None else release.licence,
        "trained_on": provenance.trained_on if release is None else release.trained_on,
    }


def _answer(
    content: bytes, times: Times, media_type: str = "application/json", headers: Mapping[str, str] | None = None
) -> Response:
    timing = f"wait;dur={math.ceil(times.waiting * 1000)}, compute;dur={math.ceil(times.computing * 1000)}"
    return Response(
        content,
        headers={"content-type": media_type, "server-timing": timing, "cache-control": "no-store"}
        | dict(headers or {}),
    )


def _json(values: object) -> Response:
    return Response(dump(values), headers={"content-type": "application/json", "cache-control": "no-store"})


def _refusal(problem: Problem) -> Response:
    return Response(problem.body, problem.status, headers=problem.headers)


def _page_file(file: PageFile) -> Callable[[Request], Any]:
    async def get(request: Request) -> Response:
        headers = {"etag": file.tag, "cache-control": "no-cache", "content-type": file.media_type}
        if request.headers.get("if-none-match") == file.tag:
            return Response(status_code=304, headers={"etag": file.tag})
        return Response(file.content, headers=headers)

    return get


async def _watch(request: Request, gone: asyncio.Future[None]) -> None:
    """Wait until the client hangs up."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
    if not gone.done():
        gone.set_result(None)
