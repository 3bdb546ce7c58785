"""When the validation judge has seen enough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def out_of_patience(evaluations: Sequence[Mapping[str, float]], patience: int) -> bool:
    """Whether the best success is `patience` evaluations old; never where patience is 0."""
    successes = [row["success"] for row in evaluations]
    since = len(successes) - 1 - successes.index(max(successes)) if successes else 0
    return 0 < patience <= since
