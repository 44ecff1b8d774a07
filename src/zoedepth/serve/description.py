"""The parts of OpenAPI that FastAPI cannot tell from the code: bodies, files, examples, problems."""

from collections.abc import Iterable, Mapping
from typing import Any

from zoedepth.serve.answers import FORMATS, NOTES
from zoedepth.serve.photos import MEDIA_TYPES
from zoedepth.serve.problems import KINDS, MEDIA_TYPE, Problem
from zoedepth.serve.schemas import LISTS, About, ProblemAnswer

INTRODUCTION = """Depth in metres from a single photo.

A photo is sent as the body of a request, or as the part `photo` of a form. Nothing of it is kept. Errors are problem
details (RFC 9457); `type` tells them apart.
"""

_FILE = {"type": "string", "format": "binary"}
_EVERYWHERE = ("401", "403", "405", "421", "500", "503")  # statuses of addresses without a body
_PARTS: dict[str, dict[str, Any]] = {
    "photo": {**_FILE, "description": "The photo's file."},
    "calibration": {
        "type": "string",
        "contentMediaType": "application/json",
        "description": "A calibration: the answer of /v1/calibrate, or a file of `zoedepth calibrate --out`.",
    },
    "points": {"description": "Pixels [x, y]: column and row.", "example": "[[12, 40], [52, 40]]"},
    "pairs": {"description": "Pairs of pixels.", "example": "[[[12, 40], [52, 40]]]"},
    "readings": {"description": "Pixels with the metres that were measured.", "example": "[[12, 40, 2.35]]"},
    "distances": {
        "description": "Pairs of pixels with the metres between them.",
        "example": "[[[12, 40], [52, 40], 0.82]]",
    },
}


def body_of(*parts: str, raw: bool = False) -> dict[str, Any]:
    """Return the description of a body with a photo.

    Args:
        parts: names of the parts that it may have beside the photo.
        raw: True if the photo may be sent by itself.
    """
    properties = {"photo": _PARTS["photo"]} | {
        name: {"type": "string", "contentMediaType": "application/json", **_PARTS[name], **_content(name)}
        for name in parts
    }
    form = {"type": "object", "required": ["photo"], "properties": properties, "additionalProperties": False}
    encoding = {name: {"contentType": "application/json"} for name in parts} | {
        "photo": {"contentType": ", ".join(["application/octet-stream", *MEDIA_TYPES.values()])}
    }
    content: dict[str, Any] = {"multipart/form-data": {"schema": form, "encoding": encoding}}
    if raw:
        content |= {media_type: {"schema": _FILE} for media_type in (*MEDIA_TYPES.values(), "application/octet-stream")}
    return {"requestBody": {"required": True, "content": content}}


def _content(name: str) -> dict[str, Any]:
    """Return the schema of the JSON in a part that is a list."""
    return {"contentSchema": LISTS[name][0].json_schema()} if name in LISTS else {}


def photo_answers() -> dict[int | str, dict[str, Any]]:
    """Return the description of the files that /v1/depth answers."""
    content: dict[str, Any] = {known.media_type: {"schema": _FILE} for known in FORMATS.values()}
    content["application/json"] = {"schema": {"$ref": "#/components/schemas/About"}}
    notes = {
        "description": "Sentences about the file, e.g. that a PNG has 256 levels per metre, or was clipped.",
        "schema": {"type": "string"},
    }
    return {200: {"description": "The depth as a file.", "headers": {NOTES: notes}, "content": content}}


def problem_answers() -> dict[int | str, dict[str, Any]]:
    """Return the description of all errors."""
    statuses: dict[int | str, dict[str, Any]] = {}
    for status in sorted({kind.status for kind in KINDS.values()}):
        kinds = {name: kind for name, kind in KINDS.items() if kind.status == status}
        statuses[status] = {
            "description": "; ".join(kind.title for kind in kinds.values()),
            "content": {
                MEDIA_TYPE: {
                    "schema": {"$ref": "#/components/schemas/ProblemAnswer"},
                    "examples": {
                        name: {"value": Problem(name, f"{kind.title}.").values} for name, kind in kinds.items()
                    },
                }
            },
        }
        if any(kind.retry_after for kind in kinds.values()):
            statuses[status]["headers"] = {
                "Retry-After": {"description": "Seconds to wait.", "schema": {"type": "integer"}}
            }
    return statuses


def describe_names(schema: dict[str, Any], models: Mapping[str, Iterable[str]], *, secret: bool) -> dict[str, Any]:
    """Complete the OpenAPI of the application with what is known once models are loaded. Calling it again is fine.

    Args:
        schema: OpenAPI as FastAPI makes it; it is changed.
        models: name of each model → the scene types that it has heads for.
        secret: True where a token is asked for.
    """
    components = schema.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for kind in (ProblemAnswer, About):
        described = kind.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas |= described.pop("$defs", {})
        schemas[kind.__name__] = described
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    names = {"model": list(models), "domain": list(dict.fromkeys(name for each in models.values() for name in each))}
    for path, methods in schema["paths"].items():
        for operation in methods.values():
            for parameter in operation.get("parameters", ()):
                if parameter["name"] in names:
                    parameter["schema"] = {"type": "string", "enum": names[parameter["name"]]}
            refusals = {status: answer for status, answer in operation["responses"].items() if status in _EVERYWHERE}
            if "requestBody" not in operation:
                operation["responses"] = {"200": operation["responses"]["200"], **refusals}
            if secret and path.startswith(("/v1/", "/metrics")):
                operation["security"] = [{"token": []}]
    if secret:
        components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    return schema
