"""Samplers as the command line names them: `rk4:8step`, `midpoint:uniform2`, `card`."""

from __future__ import annotations

import re

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_client.contract import (
    EIGHT_STEP_SCHEDULE,
    ModelCard,
    OdeSpec,
    SamplerChoice,
    uniform_schedule,
)
from anchorflow_client.errors import InvalidRequest
from anchorflow_trajectory.ode.method import method_named

CARD = "card"
FORM = re.compile(r"(?P<method>\w+):(?:uniform(?P<steps>\d+)|(?P<name>\w+))")


def parse_sampler(text: str, card: ModelCard) -> OdeSpec:
    """The sampler of that name; `card` is the card's own.

    Raises:
        BenchmarkError: the text is not of that form, or the contract knows no such sampler.
    """
    if text == CARD:
        return card.ode
    match = FORM.fullmatch(text)
    if match is None:
        raise BenchmarkError(
            f"expected {CARD}, METHOD:8step or METHOD:uniformN for a sampler, got {text!r}"
        )
    schedule = {"uniform": int(match["steps"])} if match["steps"] else match["name"]
    try:
        choice = SamplerChoice.from_fields({"method": match["method"], "schedule": schedule})
    except InvalidRequest as error:
        raise BenchmarkError(f"sampler {text!r}: {error}") from error
    return choice.over(card.ode)


def sampler_name(sampler: OdeSpec) -> str:
    """The name that `parse_sampler` takes, where the schedule has one."""
    steps = len(sampler.schedule) - 1
    schedules = {EIGHT_STEP_SCHEDULE: "8step", uniform_schedule(steps): f"uniform{steps}"}
    return f"{sampler.method}:{schedules.get(sampler.schedule, f'{steps} steps')}"


def evaluations(sampler: OdeSpec) -> int:
    """How often the field is evaluated for a sample."""
    return method_named(sampler.method).stages * (len(sampler.schedule) - 1)
