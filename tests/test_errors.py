"""One family of exceptions, which are also the built-in ones that callers know."""

import pickle

import pytest

from zoedepth.errors import InputError, MissingExtraError, TrainingError, ZoeDepthError


@pytest.mark.parametrize(
    ("kind", "builtin"), [(InputError, ValueError), (TrainingError, Exception), (MissingExtraError, ImportError)]
)
def test_one_family(kind: type[Exception], builtin: type[Exception]) -> None:
    assert issubclass(kind, ZoeDepthError)
    assert issubclass(kind, builtin)


def test_a_missing_extra_says_how_to_install_it_on_both_sides_of_a_process_border() -> None:
    error = MissingExtraError("demo", "zoedepth demo")
    for found in (error, pickle.loads(pickle.dumps(error))):
        assert (found.extra, found.feature) == ("demo", "zoedepth demo")
        assert str(found) == "zoedepth demo needs the extra [demo]. Install it: pip install 'zoedepth[demo]'"
