"""Settings of a run: dataclasses that pydantic fills from a dataset, a YAML file and options.

Each later layer overrides the ones before it; an error names the layer, the setting and what it
expects.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import yaml
from pydantic import ConfigDict, ValidationError, create_model

from anchorflow_client.errors import AnchorFlowError

Kind = TypeVar("Kind")

PLANNER = "planner"  # the key of a planner's name, beside the settings of its run
BOUNDS = {
    "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le:g}",
    "greater_than": "more than {gt:g}",
    "less_than": "less than {lt:g}",
    "finite_number": "a finite number",
}
KINDS = {
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "string": "text",
    "tuple": "a list",
    "dataclass": "keys and values",
}
"""What pydantic expected, by the first word of its error's type."""


class ConfigError(AnchorFlowError):
    """A setting is unknown or has a wrong value; the message names it and its source."""


def setting(default: Any, about: str, **bounds: float) -> Any:
    """Return a dataclass field with a description and pydantic's bounds: `ge`, `le`, `gt`, `lt`."""
    return field(default=default, metadata={"description": about, **bounds})


def other_default(kind: type, name: str, default: Any) -> Any:
    """Return a field of `kind` with another default."""
    (base,) = (each for each in fields(kind) if each.name == name)
    return field(default=default, metadata=base.metadata)


@dataclass(frozen=True)
class Setting:
    """One leaf of a configuration: `path` is dotted, `hint` its type."""

    path: str
    hint: Any
    default: Any
    about: str

    @property
    def choices(self) -> tuple[str, ...]:
        """The values of a `Literal`; empty for other types."""
        return get_args(self.hint) if get_origin(self.hint) is Literal else ()


def settings(kind: type, prefix: str = "") -> Iterator[Setting]:
    """Yield every leaf of a nested dataclass, in order."""
    hints = get_type_hints(kind)
    for part in fields(kind):
        path, hint = prefix + part.name, hints[part.name]
        if is_dataclass(hint):
            yield from settings(hint, f"{path}.")  # type: ignore[arg-type]
        else:
            yield Setting(path, hint, part.default, part.metadata.get("description", ""))


def nested(path: str, value: Any) -> dict[str, Any]:
    """Return {"a": {"b": value}} for the path "a.b"."""
    first, _, rest = path.partition(".")
    return {first: nested(rest, value) if rest else value}


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with its leaves overridden by those of `over`."""
    result = dict(base)
    for name, value in over.items():
        both = isinstance(value, Mapping) and isinstance(result.get(name), Mapping)
        result[name] = merged(result[name], value) if both else value
    return result


def build(kind: type[Kind], values: Mapping[str, Any], *, source: str) -> Kind:
    """Return the dataclass of a mapping; missing values keep their defaults."""
    return _filled(kind, {source: values})


def layers(
    kind: type[Kind],
    base: Mapping[str, Any],
    file: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> Kind:
    """Return the configuration of the defaults, `base`, the file and the options, in this order.

    options: by dotted path, `{"batch.scenes": 8}`
    """
    given = {"dataset": base}
    if file:
        given[str(file)] = _of_planner(file, kind)
    typed: dict[str, Any] = {}
    for path, value in (options or {}).items():
        typed = merged(typed, nested(path, value))
    return _filled(kind, given | {"command line": typed})


def text_in(path: Path, key: str) -> str | None:
    """Return the text of a key of a YAML file, if it is there; raise `ConfigError`."""
    value = _read(path).get(key)
    if not isinstance(value, str | None):
        raise ConfigError(f"{path}: {key}: expected text, got {value!r}")
    return value


def config_text(config: Any) -> str:
    """Return the whole configuration as the YAML that `layers` reads."""
    named = {PLANNER: config.planner, **asdict(config)}
    return yaml.safe_dump(_plain(named), sort_keys=False)


def check_fixed(config: Any, fixed: Mapping[str, Any], *, by: str, prefix: str = "model.") -> None:
    """Raise `ConfigError` if a setting differs from what the data, named in `by`, require."""
    for name, value in fixed.items():
        own = getattr(config, name)
        if isinstance(value, Mapping):
            check_fixed(own, value, by=by, prefix=f"{prefix}{name}.")
        elif own != value:
            raise ConfigError(f"{prefix}{name}: expected {value}, as {by} have, got {own}")


def _of_planner(path: Path, kind: Any) -> dict[str, Any]:
    values = _read(path)
    planner = values.pop(PLANNER, kind.planner)
    if planner != kind.planner:
        raise ConfigError(f"{path}: {PLANNER}: expected {kind.planner!r}, got {planner!r}")
    return values


def _read(path: Path) -> dict[str, Any]:
    try:
        values = yaml.safe_load(path.read_text()) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: {error}") from error
    if not isinstance(values, Mapping):
        raise ConfigError(f"{path}: expected keys and values, got {type(values).__name__}")
    return dict(values)


def _plain(value: Any) -> Any:
    """Return the value with lists for tuples: YAML has no other sequence."""
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


@lru_cache
def _validator(kind: type) -> Any:
    return create_model(
        kind.__name__, __config__=ConfigDict(allow_inf_nan=False), value=(kind, ...)
    )


def _filled(kind: type[Kind], given: Mapping[str, Mapping[str, Any]]) -> Kind:
    """Return the dataclass of layers of values, by their sources."""
    values: dict[str, Any] = {}
    for source, each in given.items():
        values = merged(values, _parsed(kind, each, source=source))
    try:
        return _validator(kind).model_validate({"value": values}).value
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(_explained(kind, first, given)) from error


def _parsed(kind: Any, values: Mapping[str, Any], *, source: str, prefix: str = "") -> dict:
    """Return the values with text split as on a command line; raise on an unknown key."""
    hints, known = get_type_hints(kind), [part.name for part in fields(kind)]
    result = {}
    for name, value in values.items():
        path = f"{prefix}{name}"
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
            raise ConfigError(f"{source}: unknown key {path!r}; {hint}")
        hint = hints[name]
        if is_dataclass(hint) and isinstance(value, Mapping):
            value = _parsed(hint, value, source=source, prefix=f"{path}.")
        elif isinstance(value, bool) and hint in (int, float):
            value = str(value)  # which pydantic would take for 0 or 1
        elif value in ("none", "null") and type(None) in get_args(hint):
            value = None
        elif isinstance(value, str) and get_origin(hint) is tuple:
            value = value.split(",")
        result[name] = value
    return result


def _explained(kind: type, error: Mapping[str, Any], given: Mapping[str, Mapping[str, Any]]) -> str:
    """Return an error of pydantic as source, setting, expected and got."""
    names = [part for part in error["loc"][1:] if isinstance(part, str)]
    path, source, value = ".".join(names), "configuration", None
    for name, values in given.items():
        found: Any = values
        for part in names:
            found = found.get(part) if isinstance(found, Mapping) else None
        source, value = (source, value) if found is None else (name, found)
    what, context = error["type"], error.get("ctx", {})
    if what == "value_error":
        return f"{source}: {context['error']}"
    leaf = next((each for each in settings(kind) if each.path == path), None)
    if what in BOUNDS:
        expected = BOUNDS[what].format(**context)
    elif leaf and leaf.choices:
        expected = f"one of {', '.join(leaf.choices)}"
    elif leaf and what in ("missing", "too_long"):
        expected = f"{len(get_args(leaf.hint))} values"
    else:
        expected = KINDS.get(what.partition("_")[0], error["msg"])
    return f"{source}: {path}: expected {expected}, got {value!r}"
