"""The contract's nested fields as the protocol's flat parameters: `{"sampler.method": "rk4"}`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from anchorflow_client.contract.checks import boolean, expected, text
from anchorflow_client.errors import InvalidRequest


def flatten(fields: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Every leaf by its JSON path."""
    leaves: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, Mapping):
            leaves |= flatten(value, f"{prefix}{name}.")
        else:
            leaves[prefix + name] = value
    return leaves


def nest(leaves: Mapping[str, Any]) -> dict[str, Any]:
    """`flatten` undone.

    Raises:
        InvalidRequest: one path runs through another.
    """
    fields: dict[str, Any] = {}
    for path, value in leaves.items():
        *parents, name = path.split(".")
        place = fields
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise InvalidRequest(f"expected a value or fields in {parent}, got both", path)
        if name in place:
            raise InvalidRequest(f"expected a value or fields in {name}, got both", path)
        place[name] = value
    return fields


def scalars(value: Any) -> dict[str, Any]:
    """The parameters of a header: strings, numbers and booleans by name.

    Raises:
        InvalidRequest: one is something else, or has a name that no message could carry.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise expected("parameters", "an object", value)
    for name, scalar in value.items():
        text(name, "parameters")
        if not isinstance(scalar, str | int | float):
            raise expected(name, "a string, a number or a boolean", scalar)
    return dict(value)


def check_binary_output(leaves: dict[str, Any]) -> None:
    """Take `binary_data_output` out. Raises `InvalidRequest` where it asks for outputs in JSON."""
    field = "binary_data_output"
    check_in_binary(boolean(leaves.pop(field, True), field), field)


def check_in_binary(wanted: bool, field: str) -> None:
    """Raises `InvalidRequest` where not."""
    if not wanted:
        raise InvalidRequest(
            "expected true, as answers have the form of requests, got false", field
        )
