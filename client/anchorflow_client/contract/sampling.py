"""How anchors are drawn and finished: sampler, refinement, warm start.

A *choice* is what a request asks, where None leaves the card's own; a *spec* is complete.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import ranges
from anchorflow_client.contract.arrays import numbers, read_only, wrong_shape
from anchorflow_client.contract.checks import (
    boolean,
    choice,
    describe,
    expected,
    fields_of,
    integer,
    number,
)
from anchorflow_client.contract.ranges import Interval
from anchorflow_client.errors import InvalidRequest

MIN_STEP = 1e-6
"""Of flow time; a multistep method weighs slopes by ratios of steps, which float32 has to hold."""


@dataclass(frozen=True)
class SamplerChoice:
    """The solver of the flow and the times it visits."""

    method: str | None = None
    """"rk4", "heun", "midpoint", "euler" or "ab2" (Adams and Bashforth's of order 2)."""
    schedule: tuple[float, ...] | None = None
    """Flow times t0 … 1, each at least MIN_STEP behind the last; t0 is 0 unless the request brings
    a warm start."""

    @classmethod
    def from_fields(cls, value: Any) -> SamplerChoice:
        """Check the JSON object; its schedule is "8step", {"uniform": n} or a list of times."""
        if isinstance(value, SamplerChoice):
            value = given(value)
        fields = fields_of(value, "sampler", ("method", "schedule"))
        method, schedule = fields.get("method"), fields.get("schedule")
        return cls(
            method=None if method is None else choice(method, "sampler.method", ranges.METHODS),
            schedule=None if schedule is None else _schedule(schedule),
        )

    def over(self, card: OdeSpec) -> OdeSpec:
        """This choice, completed by the card's."""
        return replace(card, **given(self))


@dataclass(frozen=True)
class OdeSpec(SamplerChoice):
    """A complete solver of a flow: method by name, and schedule."""

    method: str = field()
    schedule: tuple[float, ...] = field()
    kind: Literal["ode"] = "ode"

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> OdeSpec:
        """Read `asdict` back."""
        return cls(value["method"], tuple(value["schedule"]))


@dataclass(frozen=True)
class RefineChoice:
    """What is done to the samples before they are answered."""

    smooth: bool | None = None
    """Fit the spline with fixed ends."""
    project: bool | None = None
    """Push anchors out of obstacles and inside the limits."""
    safety_margin: float | None = None
    """m beyond robot_radius that the projection aims at."""
    guidance: float | None = None
    """Scale of the cost gradient inside the flow; 0 is off."""
    barrier: bool | None = None
    """Correct anchors that are still too near an obstacle by a control barrier."""
    certified_margin: float | None = None
    """m beyond robot_radius that every anchor called safe keeps."""

    @classmethod
    def from_fields(cls, value: Any) -> RefineChoice:
        """Check the JSON object."""
        if isinstance(value, RefineChoice):
            value = given(value)
        names = ("smooth", "project", "safety_margin", "guidance", "barrier", "certified_margin")
        fields = {k: v for k, v in fields_of(value, "refine", names).items() if v is not None}
        checked: dict[str, Any] = {
            name: boolean(fields[name], f"refine.{name}")
            for name in ("smooth", "project", "barrier")
            if name in fields
        } | {
            name: number(fields[name], f"refine.{name}", interval)
            for name, interval in _REFINE_INTERVALS.items()
            if name in fields
        }
        return cls(**checked)

    def over(self, card: RefineSpec) -> RefineSpec:
        """This choice, completed by the card's."""
        return replace(card, **given(self))


@dataclass(frozen=True)
class RefineSpec(RefineChoice):
    """A complete refinement of splines."""

    smooth: bool = field()
    project: bool = field()
    safety_margin: float = field()
    guidance: float = field()
    barrier: bool = False
    certified_margin: float = 0.0
    kind: Literal["spline"] = "spline"


@dataclass(frozen=True, eq=False)
class WarmStart:
    """A trajectory to start from, at flow time `tau`, in place of noise."""

    trajectory: NDArray[np.float64]
    """[T,D], [T,2D] or [T,3D]: p in m, then v in m/s, then a in m/s^2."""
    tau: float
    """Flow time in (0, 1); near 1 the answer stays near the trajectory."""
    dt: float | None = None
    """s between two of its samples; None: it lasts as long as the request's or the card's
    `horizon_s` or, where neither has one, as long as the model thinks that its way takes."""

    @classmethod
    def from_fields(cls, value: Any, *, dim: int) -> WarmStart:
        """Check the JSON object beside states of D = `dim`."""
        if isinstance(value, WarmStart):
            value = vars(value)
        fields = fields_of(value, "warm_start", ("trajectory", "tau", "dt"), ("trajectory",))
        tau, dt = fields.get("tau"), fields.get("dt")
        tau = ranges.DEFAULT_TAU if tau is None else tau
        return cls(
            read_only(_warm_trajectory(fields["trajectory"], dim)),
            number(tau, "warm_start.tau", ranges.INSIDE_UNIT),
            None if dt is None else number(dt, "warm_start.dt", ranges.TIME_STEP),
        )


_REFINE_INTERVALS = {
    "safety_margin": ranges.SAFETY_MARGIN,
    "guidance": ranges.GUIDANCE,
    "certified_margin": ranges.CERTIFIED_MARGIN,
}


def given(choice: SamplerChoice | RefineChoice) -> dict[str, Any]:
    """The fields of a choice that are not left to the card."""
    kind = SamplerChoice if isinstance(choice, SamplerChoice) else RefineChoice
    asked = {part.name: getattr(choice, part.name) for part in fields(kind)}
    return {name: value for name, value in asked.items() if value is not None}


def _schedule(value: Any) -> tuple[float, ...]:
    field = "sampler.schedule"
    match value:
        case list() | tuple() | np.ndarray():  # before "8step", to which numpy compares by element
            return _increasing(numbers(value, field, ranges.UNIT, "[K]"))
        case "8step":
            return ranges.EIGHT_STEP_SCHEDULE
        case dict():
            steps = fields_of(value, field, ("uniform",), ("uniform",))["uniform"]
            return uniform_schedule(integer(steps, f"{field}.uniform", _STEPS))
        case _:
            raise expected(field, '"8step", {"uniform": n} or a list of flow times', value)


_STEPS = Interval(1, ranges.MAX_SCHEDULE_STEPS)


def uniform_schedule(steps: int) -> tuple[float, ...]:
    """`steps` equal strides from 0 to 1."""
    return tuple(k / steps for k in range(steps + 1))


def _increasing(times: NDArray[np.float64]) -> tuple[float, ...]:
    field = "sampler.schedule"
    if times.ndim != 1 or not 2 <= times.size <= ranges.MAX_SCHEDULE_STEPS + 1:
        raise wrong_shape(field, f"[K], K from 2 to {ranges.MAX_SCHEDULE_STEPS + 1}", times)
    visited: list[float] = times.tolist()
    shortest = min(later - earlier for earlier, later in pairwise(visited))
    if shortest <= 0:
        raise InvalidRequest(f"expected strictly increasing times, got {visited}", field)
    if shortest < MIN_STEP:
        what = f"times at least {MIN_STEP:g} apart"
        raise InvalidRequest(f"expected {what}, got {visited}", field)
    if visited[-1] != 1.0:
        raise InvalidRequest(f"expected a last time of 1, got {describe(visited[-1])}", field)
    return tuple(visited)


def _warm_trajectory(value: Any, dim: int) -> NDArray[np.float64]:
    most = ranges.STATE_FIELDS * dim
    field, shape = "warm_start.trajectory", f"[T,{dim}] to [T,{most}]"
    trajectory = numbers(value, field, ranges.WARM_START, shape)
    steps, size = trajectory.shape if trajectory.ndim == 2 else (0, 0)
    if not (2 <= steps <= ranges.MAX_WARM_START_STEPS and dim <= size <= most):
        raise wrong_shape(field, shape, trajectory)
    return trajectory
