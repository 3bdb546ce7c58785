"""A run's configuration from its layers: defaults, the dataset, a YAML file, options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import yaml

from anchorflow_training.config import RunConfig, TrainerConfig
from anchorflow_training.settings import ConfigError, build, checked, merged, nested

Config = TypeVar("Config", bound=RunConfig)

PLANNER = "planner"  # the key of a planner's name, beside the settings of its run


def read_config(path: Path, kind: type[RunConfig] = TrainerConfig) -> dict[str, Any]:
    """The settings of a YAML file; raises `ConfigError` naming the file and the key."""
    values = _read(path)
    planner = values.pop(PLANNER, kind.planner)
    if planner != kind.planner:
        raise ConfigError(f"{path}: {PLANNER}: expected {kind.planner!r}, got {planner!r}")
    return checked(kind, values, source=str(path))


def planner_in(path: Path) -> str | None:
    """The planner that a YAML file names, if it does; raises `ConfigError`."""
    planner = _read(path).get(PLANNER)
    if not isinstance(planner, str | None):
        raise ConfigError(f"{path}: {PLANNER}: expected a planner's name, got {planner!r}")
    return planner


def _read(path: Path) -> dict[str, Any]:
    try:
        values = yaml.safe_load(path.read_text()) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: {error}") from error
    if not isinstance(values, Mapping):
        raise ConfigError(f"{path}: expected keys and values, got {type(values).__name__}")
    return dict(values)


def layers(
    kind: type[Config],
    base: Mapping[str, Any],
    file: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> Config:
    """What the defaults, `base`, the file and the options say, the later over the earlier.

    options: by dotted path, `{"batch.scenes": 8}`
    """
    values = merged(base, read_config(file, kind)) if file else dict(base)
    for path, value in (options or {}).items():
        given = checked(kind, nested(path, value), source="command line")
        values = merged(values, given)
    return build(kind, values, source="configuration")


def config_text(config: RunConfig) -> str:
    """The whole configuration as the YAML that `read_config` reads."""
    named = {PLANNER: config.planner, **asdict(config)}
    return yaml.safe_dump(_plain(named), sort_keys=False)


def _plain(value: Any) -> Any:
    """Tuples as lists: YAML has no other sequence."""
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
