import pytest

from zoedepth.config.checks import require, require_crf_widths
from zoedepth.errors import InputError


def test_error_names_the_field_the_values_it_may_have_and_the_value_it_has():
    with pytest.raises(InputError, match=r"^head\.n_bins must be at least 2; it is 1$"):
        require(False, "head.n_bins", "at least 2", 1)
    require(True, "head.n_bins", "at least 2", 2)


@pytest.mark.parametrize(
    ("widths", "heads", "seed_width", "message"),
    [
        ((16, 6), (1, 1), 2, r"head\.widths must be multiples of 4.*\(16, 6\)"),
        ((16, 0), (1, 1), 2, r"head\.widths must be multiples of 4.*\(16, 0\)"),
        ((16, 8), (4, 3), 2, r"head\.attention_heads must be divisors of the widths \(16, 8\).*\(4, 3\)"),
        ((16, 8), (4, 0), 2, r"head\.attention_heads must be divisors"),
        ((16, 8), (4, 2), 3, r"head\.seed_width must be a multiple of 2; it is 3"),
        ((16, 8), (4, 2), 0, r"head\.seed_width must be a multiple of 2; it is 0"),
    ],
)
def test_widths_that_make_no_level_are_errors(
    widths: tuple[int, ...], heads: tuple[int, ...], seed_width: int, message: str
):
    with pytest.raises(InputError, match=message):
        require_crf_widths(widths, heads, seed_width, "head")


def test_smallest_widths_that_make_a_level():
    require_crf_widths((4, 8), (4, 8), 2, "network")
