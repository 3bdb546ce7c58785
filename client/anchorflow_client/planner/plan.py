"""The plan that a `Planner` hands to its control loop, and how it looks as time passes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_client.errors import AnchorFlowError, UsageError

Array = NDArray[np.float64]

STEP_ROUNDING = 1e-9
"""Steps past the last sample that are rounding errors."""


class PlanState(Enum):
    """What the control loop may do with a plan."""

    WAITING = "waiting"
    """No answer has arrived yet: stand still."""
    FRESH = "fresh"
    """The last request was answered, and the answer is young enough: follow safe anchors."""
    HELD = "held"
    """A request has failed since; the last answer is young enough: follow safe anchors."""
    EXPIRED = "expired"
    """The last answer is older than the limit, or than its anchors last: brake."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The newest finished batch, and its age."""

    state: PlanState
    batch: AnchorBatch | None = None
    """None while waiting and once expired, so that an old batch cannot be followed by mistake."""
    age_ms: float = float("inf")
    """Time since the loop observed the state from which the batch starts; infinite while waiting.
    """
    request_id: str | None = None
    """The request of the newest answer, expired or not."""
    last_error: AnchorFlowError | None = None
    """Why the last request failed, or could not be made; None if it was answered."""
    best: int | None = None
    """The anchor to follow: the best on the route in use, unless another route is better by far."""
    on_route: NDArray[np.bool_] | None = None
    """[N], the anchors that take the same route as `best`."""
    stuck: bool = False
    """The robot does not move on: its route was just given up, and the next request tries another.
    """
    reason: str | None = None
    """Why no anchor is safe to follow; None if one is."""

    @property
    def usable(self) -> bool:
        """Return whether there is a batch that is young enough, safe or not."""
        return self.batch is not None

    @property
    def followable(self) -> bool:
        """Return whether `best` may be followed: it is usable and not known to be unsafe."""
        return self.usable and self.reason is None

    @property
    def expired(self) -> bool:
        """Return whether there was a batch that is too old now."""
        return self.state is PlanState.EXPIRED

    def states(self, *, ahead_s: float = 0.0) -> Array:
        """Return [N,T,3D] position, velocity, acceleration of the anchors from `ahead_s` from now.

        Each is sampled at its own `batch.dt`; an anchor that has ended continues at its last
        velocity. Raises `UsageError` if the plan is not usable.
        """
        if self.batch is None:
            raise UsageError(f"expected a usable plan, got one that is {self.state.value}")
        states = states_of(self.batch)
        return shifted(states, dt=self.batch.dt, elapsed_s=1e-3 * self.age_ms + ahead_s)


def states_of(batch: AnchorBatch) -> Array:
    """Return [N,T,3D] position, velocity and acceleration of every anchor."""
    fields = (batch.trajectories, batch.velocities, batch.accelerations)
    return np.concatenate(fields, axis=-1, dtype=np.float64)


def shifted(
    states: Array, *, dt: ArrayLike, elapsed_s: float, later_dt: ArrayLike | None = None
) -> Array:
    """Return the rest of states [...,T,3D] `elapsed_s` later, resampled at T steps.

    Between samples they are interpolated linearly. Past the last sample the motion continues at its
    last velocity without acceleration.

    Args:
        states: position, velocity and acceleration.
        dt: s between two samples, one number, or [...] for motions with their own durations.
        elapsed_s: s that have passed.
        later_dt: s between two samples of the result; by default `dt`.
    """
    steps, dim = states.shape[-2], states.shape[-1] // 3
    step = np.asarray(dt, dtype=np.float64)[..., None]
    later_step = step if later_dt is None else np.asarray(later_dt, dtype=np.float64)[..., None]
    at = np.arange(steps) * (later_step / step) + elapsed_s / step
    at = np.broadcast_to(at, states.shape[:-1])
    low = np.minimum(at.astype(int), steps - 2)
    share = np.minimum(at - low, 1.0)[..., None]
    before, after = (np.take_along_axis(states, k[..., None], axis=-2) for k in (low, low + 1))
    later = (1.0 - share) * before + share * after
    beyond = np.maximum(at - (steps - 1), 0.0)[..., None]
    later[..., :dim] += beyond * step[..., None] * states[..., -1:, dim : 2 * dim]
    later[beyond[..., 0] > STEP_ROUNDING, 2 * dim :] = 0.0
    return later


def why_unsafe(batch: AnchorBatch) -> str | None:
    """Return why no anchor is safe; None if one is, or if the batch has no `safe`."""
    safe = batch.arrays.get("safe")
    if safe is None or safe.any():
        return None
    return batch.reason or f"none of {len(safe)} anchors is safe"
