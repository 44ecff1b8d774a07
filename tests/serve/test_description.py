import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.serve.running import Client, photo

from zoedepth.serve.photos import MEDIA_TYPES
from zoedepth.serve.problems import KINDS

schemathesis = pytest.importorskip("schemathesis")

# A photo with nothing in it, and a point outside of it, are refused in words: a schema cannot tell them apart.
REFUSED = ["2xx", "413", "415", "422"]
ROUNDS = {"POST": 6, "GET": 2}


@pytest.fixture(scope="module")
def described(client: Client) -> dict[str, Any]:
    """The OpenAPI of a service."""
    return client.ask("/openapi.json").json


@pytest.fixture(scope="module")
def schema(client: Client) -> Any:
    """The same, for Schemathesis, which sends small real photos where a photo is asked for."""
    photos = st.sampled_from([photo(16, 12), photo(16, 12, format="JPEG")])
    for media_type in (*MEDIA_TYPES.values(), "application/octet-stream"):
        schemathesis.openapi.media_type(media_type, photos)
    schemathesis.openapi.format("binary", photos)
    config = schemathesis.Config.from_dict({"checks": {"positive_data_acceptance": {"expected-statuses": REFUSED}}})
    return schemathesis.openapi.from_url(f"http://127.0.0.1:{client.port}/openapi.json", config=config)


def calls(operation: Any, mode: Any) -> Callable[[], None]:
    """A test that sends what the description allows, or what it forbids, and compares the answers with it."""

    @settings(max_examples=ROUNDS[operation.method.upper()], suppress_health_check=list(HealthCheck))
    @given(case=operation.as_strategy(generation_mode=mode))
    def send(case: Any) -> None:
        case.validate_response(case.call())

    return send


@pytest.mark.parametrize("path", ["/v1/depth", "/v1/measure", "/v1/calibrate"])
@pytest.mark.parametrize("mode", ["positive", "negative"])
def test_photos_are_answered_as_is_described(path: str, mode: str, schema: Any) -> None:
    calls(schema[path]["POST"], schemathesis.GenerationMode(mode))()


@pytest.mark.parametrize("path", ["/v1/models", "/healthz", "/readyz", "/metrics"])
def test_questions_are_answered_as_is_described(path: str, schema: Any) -> None:
    calls(schema[path]["GET"], schemathesis.GenerationMode.POSITIVE)()


def test_every_address_of_a_service_is_described(described: dict[str, Any]) -> None:
    assert set(described["paths"]) == {
        "/v1/depth", "/v1/measure", "/v1/calibrate", "/v1/models", "/healthz", "/readyz", "/metrics",
    }  # fmt: skip


def test_models_and_domains_are_named(described: dict[str, Any]) -> None:
    parameters = {each["name"]: each for each in described["paths"]["/v1/depth"]["post"]["parameters"]}
    assert parameters["model"]["schema"]["enum"] == ["tiny"]
    assert parameters["domain"]["schema"]["enum"] == ["indoor", "outdoor"]
    assert all(each["description"] for each in parameters.values())


def test_every_kind_of_problem_has_an_example(described: dict[str, Any]) -> None:
    answers = described["paths"]["/v1/depth"]["post"]["responses"]
    examples = {
        name
        for answer in answers.values()
        for name in answer["content"].get("application/problem+json", {}).get("examples", {})
    }
    assert examples == set(KINDS)
    assert "Retry-After" in answers["429"]["headers"]


def test_every_reference_leads_somewhere(described: dict[str, Any]) -> None:
    text = json.dumps(described)
    names = {part.partition('"')[0] for part in text.split("#/components/schemas/")[1:]}
    assert names <= set(described["components"]["schemas"])
    assert "HTTPValidationError" not in text
