import pytest

from zoedepth.errors import InputError
from zoedepth.serve.settings import Limits, Settings


def test_defaults_are_those_that_the_documentation_promises() -> None:
    limits = Limits()
    assert (limits.max_body, limits.max_pixels, limits.queue) == (50_000_000, 50_000_000, 64)
    assert (limits.max_wait, limits.max_seconds) == (30, 60)
    assert limits.grace < 20


@pytest.mark.parametrize("name", ["max_body", "max_pixels", "max_wait", "grace", "idle"])
@pytest.mark.parametrize("value", [0, -1, float("inf"), float("nan")])
def test_a_limit_must_be_above_0(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        Limits(**{name: value})


def test_a_service_may_have_no_queue() -> None:
    assert Limits(queue=0).queue == 0


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"models": ()}, "--model"),
        ({"threads": 0}, "threads"),
        ({"batch_size": 0}, "batch_size"),
        ({"token": "short"}, "token"),
        ({"token": "ä" * 20}, "token"),
        ({"hosts": ("http://a",)}, "--allow-host"),
        ({"hosts": ("a:80",)}, "--allow-host"),
        ({"origins": ("example.org",)}, "--allow-origin"),
        ({"origins": ("*",)}, "--allow-origin"),
        ({"origins": ("https://a/b",)}, "--allow-origin"),
    ],
)
def test_what_makes_no_sense_is_refused(wrong: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        Settings(**wrong)


def test_the_token_is_not_shown() -> None:
    assert "secretsecretsecret" not in repr(Settings(token="secretsecretsecret"))
