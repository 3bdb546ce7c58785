"""The settings of a `TrajectoryGenerator`, and the anchors that it returns."""

from __future__ import annotations

from dataclasses import dataclass, fields

from torch import Tensor

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, uniform_schedule
from anchorflow_models.checks import check
from anchorflow_trajectory.ode.methods import METHODS as SOLVERS
from anchorflow_trajectory.ode.schedule import Schedule, check_schedule

ADAPTIVE = "rk45"
METHODS = (*SOLVERS, ADAPTIVE)
SCHEDULES = ("uniform", "8step")


@dataclass(frozen=True)
class GeneratorConfig:
    """Settings of many scenes; the generator's methods take what belongs to one scene.

    method: "euler", "midpoint", "heun", "rk4", "ab2", or "rk45": Dormand and Prince's pair of
        orders 5 and 4, which chooses its own steps from the schedule's first time on
    schedule: "uniform", "8step", or flow times that rise strictly from 0 to 1
    steps: of the uniform schedule
    rtol, atol: of rk45 for each anchor; atol in the state's units, m and log duration
    num_samples: N
    smooth: fit the B-spline that meets both ends
    project: push anchors out of obstacles and inside the limits, and pull those that stay unsafe
        towards the nearest safe anchor
    safety_margin: m of clearance that projection and barrier aim at
    refine_steps: descents of the projection
    barrier: correct finished anchors that are not clear enough by a control barrier
    certified_margin: m of clearance that anchors called safe keep
    barrier_rate: of a control barrier that steers anchors clear while they are drawn: a shortfall
        of clearance falls as exp(-rate t). 5 is a good value; None is off

    Raises:
        ValueError: a field is out of its range; the message names it.
    """

    method: str = "rk4"
    schedule: str | Schedule = "uniform"
    steps: int = 8
    rtol: float = 1e-4
    atol: float = 1e-4
    num_samples: int = 64
    smooth: bool = True
    project: bool = True
    safety_margin: float = 0.1
    refine_steps: int = 20
    barrier_rate: float | None = None
    barrier: bool = False
    certified_margin: float = 0.0

    def __post_init__(self) -> None:
        check("method", self.method in METHODS, f"one of {', '.join(METHODS)}", repr(self.method))
        for name in ("steps", "num_samples", "refine_steps"):
            value = getattr(self, name)
            check(name, isinstance(value, int) and value >= 1, "a whole number of 1 or more", value)
        for name in ("rtol", "atol"):
            check(name, getattr(self, name) > 0, "a number above 0", getattr(self, name))
        for name in ("safety_margin", "certified_margin"):
            margin = getattr(self, name)
            check(name, 0 <= margin < float("inf"), "0 m or more", margin)
        rate = self.barrier_rate
        check("barrier_rate", rate is None or 0 < rate < float("inf"), "a number above 0", rate)
        self._check_schedule()

    @property
    def flow_times(self) -> Schedule:
        """Return the schedule as flow times from 0 to 1."""
        if self.schedule == "uniform":
            return uniform_schedule(self.steps)
        if self.schedule == "8step":
            return EIGHT_STEP_SCHEDULE
        return tuple(float(t) for t in self.schedule)

    def _check_schedule(self) -> None:
        named = not isinstance(self.schedule, str) or self.schedule in SCHEDULES
        known = f"one of {', '.join(SCHEDULES)}, or flow times"
        check("schedule", named, known, repr(self.schedule))
        try:
            times = check_schedule(self.flow_times)
        except (TypeError, ValueError) as error:
            raise ValueError(f"schedule: {error}") from error
        # x_0 is a state of t = 0; only a warm start begins later.
        check("schedule", times[0] == 0.0, "a first flow time of 0", times[0])


@dataclass(frozen=True, eq=False)
class AnchorTensors:
    """N anchors of a scene in SI and the map's frame, on the model's device.

    A B axis leads if scenes were batched.

    trajectories, velocities, accelerations: [N, T, D] in m, m/s, m/s^2
    scores: [N], minus the expert's cost for the style; higher is better
    clearance: [N] m beyond the robot's radius, smallest along the path
    safe: [N] bool: the clearance suffices along the whole path, and speed and acceleration keep
        their limits
    durations: [N] s from the first to the last time step
    """

    trajectories: Tensor
    velocities: Tensor
    accelerations: Tensor
    scores: Tensor
    clearance: Tensor
    safe: Tensor
    durations: Tensor

    def scene(self, index: int) -> AnchorTensors:
        """Return the anchors of one scene of a batch."""
        return AnchorTensors(*(getattr(self, field.name)[index] for field in fields(self)))
