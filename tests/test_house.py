"""Rules of the house that no linter knows (CONTRIBUTING.md): what a file may do, and where its tests lie."""

import ast
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "zoedepth"
MODULES = sorted(PACKAGE.rglob("*.py"))
LIBRARY = [path for path in MODULES if path.parent.name != "commands" and path != PACKAGE / "cli.py"]
"""Everything but the command line."""
LATE = [
    PACKAGE / name
    for name in ("__init__.py", "predict.py", "runtimes/exports.py", "weights/exported.py", "weights/load.py")
]
"""Modules that start without torch, and import what needs it when it is needed."""


def broken(rule: Callable[[ast.Module], Iterable[int]], paths: Iterable[Path]) -> str:
    """Return "path:line" of every place that breaks a rule, a line each."""
    return "\n".join(
        f"{path.relative_to(ROOT).as_posix()}:{line}"
        for path in paths
        for line in rule(ast.parse(path.read_text(encoding="utf-8")))
    )


def prints(tree: ast.Module) -> Iterator[int]:
    """Yield the lines that call ``print``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
            yield node.lineno


def own_imports_in_functions(tree: ast.Module) -> Iterator[int]:
    """Yield the lines inside of functions that import the package's own modules."""
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            for node in ast.walk(function):
                if isinstance(node, ast.ImportFrom):
                    names = ["zoedepth" if node.level else node.module or ""]
                elif isinstance(node, ast.Import):
                    names = [alias.name for alias in node.names]
                else:
                    continue
                if any(name.partition(".")[0] == "zoedepth" for name in names):
                    yield node.lineno


def settings_of_its_own(tree: ast.Module) -> Iterator[int]:
    """Yield the lines that set more of Hypothesis than the number of examples and which complaints do not matter."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "settings":
            given = {keyword.arg for keyword in node.keywords}
            if not given <= {"max_examples", "deadline", "suppress_health_check", None}:
                yield node.lineno


def test_the_rules_notice_what_they_forbid() -> None:
    tree = ast.parse(
        "import zoedepth.errors\n"
        "@settings(max_examples=9, derandomize=False)\n"
        "def function():\n"
        "    print('hello')\n"
        "    from zoedepth.model import beit\n"
        "    import torch, zoedepth.model\n"
        "    import torchvision\n"
        "    from . import beit\n"
    )
    assert list(prints(tree)) == [4]
    assert list(own_imports_in_functions(tree)) == [5, 6, 8]
    assert list(settings_of_its_own(tree)) == [2]
    assert {PACKAGE / "predict.py", PACKAGE / "model" / "zoedepth.py"} <= set(LIBRARY)
    assert PACKAGE / "commands" / "predict.py" not in LIBRARY


def test_library_code_prints_nothing() -> None:
    assert broken(prints, LIBRARY) == ""


def test_own_modules_are_imported_at_the_top_of_a_file() -> None:
    assert broken(own_imports_in_functions, [path for path in LIBRARY if path not in LATE]) == ""


def test_every_module_has_a_test_file_at_the_mirrored_path() -> None:
    modules = [path.relative_to(PACKAGE) for path in MODULES if not path.name.startswith("__")]
    tests = [Path("tests") / path.parent / f"test_{path.name}" for path in modules]
    assert "\n".join(path.as_posix() for path in tests if not (ROOT / path).is_file()) == ""


def test_fuzz_tests_leave_to_the_profile_which_examples_they_get() -> None:
    assert broken(settings_of_its_own, (ROOT / "tests").rglob("*.py")) == ""
