"""Configurations as plain values, ready for JSON, and back."""

import dataclasses
import types
import typing
from typing import Any, Literal, TypeVar, Union

from zoedepth.config.baselines import NETWORK_CONFIGS
from zoedepth.config.heads import HEAD_CONFIGS
from zoedepth.config.model import AnyModelConfig, BaselineConfig, ModelConfig
from zoedepth.errors import InputError

_TYPES: dict[str, type] = {"zoedepth": ModelConfig, "baseline": BaselineConfig}
_NAMES = {kind: name for table in (_TYPES, HEAD_CONFIGS, NETWORK_CONFIGS) for name, kind in table.items()}
"""Config class → its ``type`` in files, where a field may hold one of several classes."""
_TYPE = "type"


def to_dict(config: Any) -> dict[str, Any]:
    """Turn a config dataclass into plain dicts, lists and values, ready for JSON.

    The entry ``type`` names the class where a field may hold one of several.
    """
    tag = {_TYPE: _NAMES[type(config)]} if type(config) in _NAMES else {}
    return tag | {item.name: _plain(getattr(config, item.name)) for item in dataclasses.fields(config)}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_dict(value)
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value


ConfigType = TypeVar("ConfigType")


def from_dict(config_type: type[ConfigType], values: dict[str, Any], *, where: str = "config") -> ConfigType:
    """Build a config from ``to_dict``'s plain values.

    Files from before there were several classes have no ``type``; they hold a ZoeDepth with attractors.

    Raises:
        InputError: a field is unknown, has a wrong type, or is missing and has no default; the message names it.
    """
    return _build(config_type, values, where)


def model_config_from_dict(values: Any, *, where: str = "config") -> AnyModelConfig:
    """Build the config of any model from ``to_dict``'s plain values.

    Raises:
        InputError: see ``from_dict``.
    """
    return _build(AnyModelConfig, values, where)


def _build(kind: Any, value: Any, where: str) -> Any:
    """Turn ``value``, read from JSON, into the annotated type ``kind``."""
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return _build_dataclass(kind, value, where)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise InputError(f"{where} must be a list, not {value!r}")
        kinds = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else list(arguments)
        if len(kinds) != len(value):
            raise InputError(f"{where} must have {len(kinds)} entries, not {len(value)}")
        return tuple(_build(k, v, f"{where}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=True)))
    if origin is Literal:
        if not any(value == known and type(value) is type(known) for known in arguments):  # in Python True == 1
            raise InputError(f"{where} must be one of {list(arguments)}, not {value!r}")
        return value
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        kinds = [k for k in arguments if k is not type(None)]
        return _build(kinds[0] if len(kinds) == 1 else _chosen(kinds, value, where), value, where)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):  # in Python a bool is an int
        raise InputError(f"{where} must be {kind.__name__}, not {value!r}")
    return value


def _chosen(kinds: list[Any], value: Any, where: str) -> Any:
    """Choose the dataclass that a JSON object belongs to."""
    known = {_NAMES[kind]: kind for kind in kinds}
    if not isinstance(value, dict):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{where} must be an object with the fields of {names}, not {value!r}")
    name = value.get(_TYPE, next(iter(known)))
    if not isinstance(name, str) or name not in known:
        raise InputError(f"{where}.{_TYPE} must be one of {list(known)}, not {name!r}")
    return known[name]


def _build_dataclass(kind: Any, value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise InputError(f"{where} must be an object with the fields of {kind.__name__}, not {value!r}")
    if kind in _NAMES and value.get(_TYPE, _NAMES[kind]) == _NAMES[kind]:
        value = {name: item for name, item in value.items() if name != _TYPE}
    known = {item.name: item for item in dataclasses.fields(kind)}
    if unknown := sorted(set(value) - set(known)):
        raise InputError(
            f"{where} has unknown fields {unknown}. {kind.__name__} has {sorted(known)}; rename or remove them."
        )
    # All other fields have defaults. A field added later must default to the behaviour of before.
    required = (f for f in known.values() if f.default is f.default_factory is dataclasses.MISSING)
    if missing := sorted(f.name for f in required if f.name not in value):
        raise InputError(f"{where} lacks the fields {missing}, which have no default. Add them.")
    hints = typing.get_type_hints(kind)
    built = {name: _build(hints[name], item, f"{where}.{name}") for name, item in value.items()}
    return kind(**built)
