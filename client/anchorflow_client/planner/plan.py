"""The plan: what a `Planner` hands to its control loop, and how good it still is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.planner.shift import shifted, states_of


class PlanState(Enum):
    """What the loop may do with a plan."""

    WAITING = "waiting"
    """No answer has come yet: stand still."""
    FRESH = "fresh"
    """The last request was answered, and the answer is young enough: follow what is safe."""
    HELD = "held"
    """A request has failed since; the last good answer is young enough: follow what is safe."""
    EXPIRED = "expired"
    """The last good answer is older than the limit, or than its anchors last: brake."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The newest finished batch, as old as it is now."""

    state: PlanState
    batch: AnchorBatch | None = None
    """None while waiting and once expired: what is too old cannot be followed by mistake."""
    age_ms: float = float("inf")
    """Since the loop saw the state from which the batch starts; infinite while waiting."""
    request_id: str | None = None
    """Of the request that the newest good answer belongs to, expired or not."""
    last_error: AnchorFlowError | None = None
    """Why the last request failed, or none could be made; None where it was answered."""
    best: int | None = None
    """The anchor to follow: the best on the route in use, unless another route is better by far."""
    on_route: NDArray[np.bool_] | None = None
    """[N], the anchors that take the same route as `best`."""
    stuck: bool = False
    """The robot gets nowhere: the route was just given up, the next request tries another one."""
    reason: str | None = None
    """Why there is nothing safe to follow; None where there is."""

    @property
    def usable(self) -> bool:
        """Whether there is a batch that is young enough, safe or not."""
        return self.batch is not None

    @property
    def followable(self) -> bool:
        """Whether `best` may be followed: it is usable and, where the planner tells, safe."""
        return self.usable and self.reason is None

    @property
    def expired(self) -> bool:
        """Whether there was a batch and it is too old now."""
        return self.state is PlanState.EXPIRED

    def states(self, *, ahead_s: float = 0.0) -> NDArray[np.float64]:
        """[N,T,3D] position, velocity, acceleration of the anchors from `ahead_s` after now on.

        Each is sampled at its own `batch.dt`; one that has come to its end goes on at its last
        velocity.

        Raises:
            ValueError: the plan is not usable.
        """
        if self.batch is None:
            raise ValueError(f"expected a usable plan, got one that is {self.state.value}")
        states = states_of(self.batch)
        return shifted(states, dt=self.batch.dt, elapsed_s=1e-3 * self.age_ms + ahead_s)


def why_unsafe(
    batch: AnchorBatch, margin_m: float, *, start_m: float = float("inf"), share_m: float = 0.0
) -> str | None:
    """Why no anchor of a batch is safe; None where one is, or where the planner does not say.

    margin_m: that is asked for
    start_m: clearance of the start in m
    share_m: m beyond the margin that the service wants kept of it
    """
    safe, clearance = batch.arrays.get("safe"), batch.arrays.get("clearance")
    if safe is None or safe.any():
        return None
    told = f"none of {len(safe)} anchors is safe"
    if start_m < margin_m + share_m:
        return (
            f"{told}: the start keeps {start_m:.3f} m of the {margin_m:.3f} m that are asked for "
            f"and {share_m:.3f} m for the width of a cell"
        )
    if clearance is None:
        return told
    widest = float(clearance.max())
    if widest >= margin_m:
        return f"{told}: those that have room break a limit or keep the margin only just"
    return f"{told}: the widest way keeps {widest:.3f} m of the {margin_m:.3f} m that are asked for"
