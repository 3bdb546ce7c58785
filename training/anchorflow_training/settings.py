"""Nested frozen dataclasses from mappings: every key checked, every value converted and bounded."""

from __future__ import annotations

import difflib
import math
import types
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from anchorflow_client.errors import AnchorFlowError

Kind = TypeVar("Kind")

WORDS = {"true": True, "false": False}
BOUNDS = {
    "least": ("at least", lambda value, bound: value >= bound),
    "most": ("at most", lambda value, bound: value <= bound),
    "above": ("more than", lambda value, bound: value > bound),
    "below": ("less than", lambda value, bound: value < bound),
}


class ConfigError(AnchorFlowError):
    """A setting is unknown or not what it should be; the message names it and where it stood."""


def setting(default: Any, about: str, **bounds: float) -> Any:
    """A dataclass field that explains itself; bounds are `least`, `most`, `above` and `below`.

    A subclass that gives it another default alone keeps them.
    """
    return field(default=default, metadata={"about": about, **bounds})


@dataclass(frozen=True)
class Setting:
    """One leaf of a configuration: `path` is dotted, `hint` its type."""

    path: str
    hint: Any
    default: Any
    about: str


def settings(kind: type, prefix: str = "") -> Iterator[Setting]:
    """Every leaf of a nested dataclass, in order."""
    hints = get_type_hints(kind)
    for part in fields(kind):
        path, hint = prefix + part.name, hints[part.name]
        if is_dataclass(hint):
            yield from settings(hint, f"{path}.")  # type: ignore[arg-type]
        else:
            yield Setting(path, hint, part.default, _metadata(kind, part.name).get("about", ""))


def nested(path: str, value: Any) -> dict[str, Any]:
    """{"a": {"b": value}} for the path "a.b"."""
    first, _, rest = path.partition(".")
    return {first: nested(rest, value) if rest else value}


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with the leaves of `over` laid on it."""
    result = dict(base)
    for name, value in over.items():
        both = isinstance(value, Mapping) and isinstance(result.get(name), Mapping)
        result[name] = merged(result[name], value) if both else value
    return result


def checked(kind: type, values: Mapping[str, Any], *, source: str, prefix: str = "") -> dict:
    """The values of a mapping, which need not be complete, converted to the fields' types.

    source: the file or option that the values come from, for the message of `ConfigError`
    """
    hints, parts = get_type_hints(kind), {part.name: part for part in fields(kind)}
    result = {}
    for name, value in values.items():
        path = f"{prefix}{name}"
        if name not in parts:
            raise ConfigError(f"{source}: unknown key {path!r}{_nearest(str(name), list(parts))}")
        hint = hints[name]
        if is_dataclass(hint):
            if not isinstance(value, Mapping):
                raise ConfigError(f"{source}: {path}: expected keys and values, got {value!r}")
            result[name] = checked(hint, value, source=source, prefix=f"{path}.")  # type: ignore[arg-type]
            continue
        try:
            result[name] = _converted(value, hint)
            _check_bounds(result[name], _metadata(kind, name))
        except ValueError as error:
            raise ConfigError(f"{source}: {path}: {error}, got {value!r}") from error
    return result


def build(kind: type[Kind], values: Mapping[str, Any], *, source: str) -> Kind:
    """The dataclass of a mapping; what it does not name keeps its default."""
    try:
        return _assembled(kind, checked(kind, values, source=source))
    except ValueError as error:
        raise ConfigError(f"{source}: {error}") from error


def _assembled(kind: type[Kind], values: Mapping[str, Any]) -> Kind:
    hints = get_type_hints(kind)
    given = {
        name: _assembled(hints[name], value) if is_dataclass(hints[name]) else value
        for name, value in values.items()
    }
    return kind(**given)


def check_fixed(config: Any, fixed: Mapping[str, Any], *, by: str, prefix: str = "model.") -> None:
    """Raise `ConfigError` where a setting is not what the data, which `by` names, fix it to."""
    for name, value in fixed.items():
        own = getattr(config, name)
        if isinstance(value, Mapping):
            check_fixed(own, value, by=by, prefix=f"{prefix}{name}.")
        elif own != value:
            raise ConfigError(f"{prefix}{name}: expected {value}, as {by} have, got {own}")


def choices(hint: Any) -> tuple[str, ...]:
    """What a setting may be, where its type lists it."""
    return get_args(hint) if get_origin(hint) is Literal else ()


def _nearest(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(known)}"


def _converted(value: Any, hint: Any) -> Any:
    """The value as the type says; text is read as a command line gives it. Raises ValueError."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None or value in ("none", "null"):
            return None
        return _converted(value, next(kind for kind in inner if kind is not type(None)))
    if origin is Literal:
        if value not in inner:
            raise ValueError(f"expected one of {', '.join(map(str, inner))}")
        return value
    if origin is tuple:
        return _sequence(value, inner)
    return _scalar(value, hint)


def _sequence(value: Any, inner: tuple[Any, ...]) -> tuple[Any, ...]:
    items = value.split(",") if isinstance(value, str) else value
    if not isinstance(items, list | tuple):
        raise ValueError("expected a list")
    kinds = [inner[0]] * len(items) if inner[-1:] == (...,) else list(inner)
    if len(kinds) != len(items):
        raise ValueError(f"expected {len(kinds)} values")
    return tuple(_converted(item, kind) for item, kind in zip(items, kinds, strict=True))


def _scalar(value: Any, kind: type) -> Any:
    if kind is bool:
        value = WORDS.get(value, value) if isinstance(value, str) else value
    elif isinstance(value, bool) and kind in (int, float):
        raise ValueError(f"expected {_named(kind)}")
    # YAML 1.1 takes 1e-3, without a point, for text.
    elif kind in (int, float) and isinstance(value, str | int):
        try:
            value = kind(value)
        except (ValueError, OverflowError):
            raise ValueError(f"expected {_named(kind)}") from None
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("expected a finite number")
    if not isinstance(value, kind):
        raise ValueError(f"expected {_named(kind)}")
    return value


def _named(kind: type) -> str:
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
    return names.get(kind, kind.__name__)


def _metadata(kind: type, name: str) -> Mapping[str, Any]:
    """What is said of a field; of one that only has another default, what its base says."""
    own = (getattr(base, "__dataclass_fields__", {}).get(name) for base in kind.__mro__)
    return next((part.metadata for part in own if part is not None and part.metadata), {})


def _check_bounds(value: Any, metadata: Mapping[str, Any]) -> None:
    for name, (words, holds) in BOUNDS.items():
        if name in metadata and value is not None and not holds(value, metadata[name]):
            raise ValueError(f"expected {words} {metadata[name]}")


def default_of(entry: Setting) -> Any:
    """A leaf's default; every leaf of a configuration must have one."""
    if entry.default is MISSING:
        raise TypeError(f"{entry.path} has no default")
    return entry.default
