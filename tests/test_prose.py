"""Docstrings say who does what: they open with a verb or a noun (CONTRIBUTING.md)."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
HEADLESS = re.compile(r"(?:of|what|the same|those|that|as|whether)\b", re.IGNORECASE)
"""Openings of a sentence whose subject stands in another one, if anywhere."""

ARGUMENT = re.compile(r"^ +(\w+): (.*)", re.MULTILINE)
"""An entry of "Args:"."""


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of every docstring, those below attributes included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value.strip()


def headless(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the line and the opening of every docstring, and of every argument in one, that has no head."""
    for line, text in docstrings(tree):
        for opening in (text, *(entry[2] for entry in ARGUMENT.finditer(text))):
            if HEADLESS.match(opening):
                yield line, opening[:60]


def test_a_headless_opening_is_noticed() -> None:
    tree = ast.parse(
        'class A:\n    """Of files."""\n    b = 1\n    """What b is."""\n    def c(self):\n'
        '        """Return it.\n\n        Args:\n            d: of a file.\n            e: a file.\n        """\n'
        '        return "Of no matter"\n'
    )
    assert [line for line, _ in headless(tree)] == [2, 4, 6]


def test_docstrings_open_with_a_verb_or_a_noun() -> None:
    found = [
        f"{path.relative_to(ROOT).as_posix()}:{line}: {opening}"
        for path in sorted((ROOT / "src").rglob("*.py"))
        for line, opening in headless(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert "\n".join(found) == ""
