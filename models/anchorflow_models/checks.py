"""Checks of settings: a ValueError names the field, what was expected and what came."""

from __future__ import annotations


def check(name: str, holds: object, expected: str, got: object) -> None:
    """Raise ValueError unless it holds."""
    if not holds:
        raise ValueError(f"{name}: expected {expected}, got {got}")
