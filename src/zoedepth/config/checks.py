"""Checks of the fields of a configuration."""

from zoedepth.errors import InputError


def require(condition: bool, name: str, expected: str, value: object) -> None:
    """Check a field of a config.

    Args:
        condition: True where the field is right.
        name: name of the field, with the part of the model it belongs to.
        expected: values that the field may have, to complete "... must be".
        value: the value it has.

    Raises:
        InputError: the condition does not hold; the message has the name, the expected values and the value.
    """
    if not condition:
        raise InputError(f"{name} must be {expected}; it is {value!r}")


MAX_INTERVALS = 10_000
"""Most intervals that DORN may have: each has its edge in a list, which must not fill the memory."""


def require_intervals(n_intervals: int, where: str) -> None:
    """Check the number of DORN's intervals of depth, in its head or in the baseline.

    Args:
        n_intervals: the number.
        where: part of the model that has this field.

    Raises:
        InputError: there are too few or too many.
    """
    require(2 <= n_intervals <= MAX_INTERVALS, f"{where}.n_intervals", f"2 to {MAX_INTERVALS:,}", n_intervals)


def require_crf_widths(widths: tuple[int, ...], heads: tuple[int, ...], seed_width: int, where: str) -> None:
    """Check the widths of NeWCRFs' levels, in its head or in the baseline.

    Args:
        widths: channels of the levels.
        heads: attention heads of the levels.
        seed_width: channels of the first value.
        where: part of the model that has these fields.

    Raises:
        InputError: a level cannot be built from them.
    """
    require(min(widths) >= 4 and all(w % 4 == 0 for w in widths), f"{where}.widths",
            "multiples of 4, since each level gives its channels to 4 pixels of the next", widths)  # fmt: skip
    require(min(heads) >= 1 and all(w % h == 0 for w, h in zip(widths, heads, strict=True)), f"{where}.attention_heads",
            f"divisors of the widths {widths}", heads)  # fmt: skip
    require(seed_width >= 2 and seed_width % 2 == 0, f"{where}.seed_width", "a multiple of 2", seed_width)
