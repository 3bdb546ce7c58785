"""A whole number in an HTTP header."""

from __future__ import annotations

MAX_DIGITS = 18  # which fit 64 bits


def whole_number(header: str | None) -> int | None:
    """The number; None where there is none, or a date as Retry-After may hold."""
    return int(header) if header and header.isdecimal() and len(header) <= MAX_DIGITS else None
