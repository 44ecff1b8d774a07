"""Checks of the fields of a configuration."""

from zoedepth.errors import InputError


def require(condition: bool, name: str, expected: str, value: object) -> None:
    """A config's check of one of its fields.

    Raises:
        InputError: the condition does not hold; the message has the field, what is expected, and what it is.
    """
    if not condition:
        raise InputError(f"{name} must be {expected}; it is {value!r}")


def require_crf_widths(widths: tuple[int, ...], heads: tuple[int, ...], seed_width: int, where: str) -> None:
    """What the widths of NeWCRFs' levels must be, in its head and in the baseline.

    Raises:
        InputError: they are not.
    """
    require(min(widths) >= 4 and all(w % 4 == 0 for w in widths), f"{where}.widths",
            "multiples of 4 (pixels are shuffled)", widths)  # fmt: skip
    require(min(heads) >= 1 and all(w % h == 0 for w, h in zip(widths, heads, strict=True)), f"{where}.attention_heads",
            f"divisors of the widths {widths}", heads)  # fmt: skip
    require(seed_width >= 2 and seed_width % 2 == 0, f"{where}.seed_width", "a multiple of 2", seed_width)
