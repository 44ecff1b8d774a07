"""Modules can be imported by their old names."""

import importlib
import sys

import pytest

from zoedepth import moved


@pytest.mark.parametrize("old", [*moved.MODULES, "zoedepth.heads.attractor", "zoedepth.convert.shapes"])
def test_old_name_is_the_module_of_today(old: str) -> None:
    sys.modules.pop(old, None)
    with pytest.warns(DeprecationWarning, match=rf"{old} is now zoedepth\.[\w.]+: the old name goes"):
        found = importlib.import_module(old)
    assert found is sys.modules[found.__name__]
    assert found.__name__ != old
    assert found.__spec__ is not None
    assert found.__spec__.name == found.__name__  # it was not changed by being found
    sys.modules.pop(old, None)


def test_old_name_of_a_function_is_the_function_of_today() -> None:
    from zoedepth import images
    from zoedepth.stored import read_depth

    with pytest.warns(DeprecationWarning, match=r"zoedepth\.images\.read_depth is now zoedepth\.stored\.read_depth"):
        assert images.read_depth is read_depth
    with pytest.raises(AttributeError, match="has no attribute 'read_dept'"):
        images.read_dept  # noqa: B018 - to look is what raises


@pytest.mark.parametrize("name", ["zoedepth.camara", "zoedepth.heads.none", "zoedepth.data.opening"])
def test_names_that_never_were_are_not_found(name: str) -> None:
    with pytest.raises(ModuleNotFoundError, match=name.rpartition(".")[2]):
        importlib.import_module(name)


def test_the_warning_is_of_the_line_that_uses_the_old_name() -> None:
    from zoedepth import images

    with pytest.warns(DeprecationWarning, match="read_depth") as warned:
        getattr(images, "read_depth")  # noqa: B009 - a plain attribute would be one for the linter, too
    sys.modules.pop("zoedepth.camera", None)
    with pytest.warns(DeprecationWarning, match="camera") as too:
        import zoedepth.camera  # noqa: F401 - importing it is what warns
    assert [warning.filename for warning in [*warned, *too]] == [__file__] * 2
    sys.modules.pop("zoedepth.camera", None)


def test_it_is_installed_once() -> None:
    n_finders = len(sys.meta_path)
    moved.install()
    assert len(sys.meta_path) == n_finders
