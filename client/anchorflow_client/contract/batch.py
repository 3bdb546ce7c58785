"""The answer: N anchors a scene, and which of them follow a route."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.card import ModelId
from anchorflow_client.contract.checks import (
    Interval,
    as_array,
    frozen,
    integer,
    number,
    read_only,
)
from anchorflow_client.errors import AbsentError, InvalidRequest, UsageError

ARRAY_DTYPES: dict[str, type[np.generic]] = {
    "trajectories": np.float32,
    "velocities": np.float32,
    "accelerations": np.float32,
    "scores": np.float32,
    "clearance": np.float32,
    "safe": np.bool_,
    "routes": np.int64,
}
"""The arrays that a planner may give; only `trajectories` is always present."""
MOTIONS = ("trajectories", "velocities", "accelerations")
"""Those of shape [N,T,D]; the others are [N]."""
WITHIN = Interval(0.0, math.inf, "m", open_high=True)
"""Allowed distances of an anchor's end from a route."""
COUNT = Interval(1, 2**31)
FUTURES, FUTURE_PROBABILITIES = "futures", "future_probabilities"
"""The extras of a planner that predicts the other road users."""
MIN_MOVE = 1.0
"""m; an anchor that moves less than this from its start counts as standing."""
NEAR = 128.0
"""m; trajectories that reach further from zero are float64, as float32 rounds them by more than
8 µm there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AnchorBatch:
    """Anchors in the request's frame; if the request was batched, a B axis leads every array."""

    arrays: Mapping[str, NDArray[Any]]
    """Read-only, by name: those of ARRAY_DTYPES on the planner's card, then the extras that the
    request listed."""
    dt: float | NDArray[np.float64]
    """s between two time steps: one number if all anchors share it, else [N], read-only."""
    first_s: float = 0.0
    """s from now to the first time step."""
    seed: int
    model: ModelId
    timing_ms: Mapping[str, float]
    """queue, encode, sample, refine, total."""
    request_id: str | None = None
    reason: str | None = None
    """Why no anchor is safe, in one sentence; None if one is. With a B axis, that of each scene
    without a safe anchor, by its number."""
    absent_inputs: tuple[str, ...] = ()
    """Optional inputs of the card that the request left out."""

    def __post_init__(self) -> None:
        """Freeze the arrays. Raises `ValueError` if shapes or times are wrong."""
        if "trajectories" not in self.arrays:
            raise ValueError("trajectories: expected [N,T,D] or [B,N,T,D], got none")
        arrays = {name: read_only(_typed(name, array)) for name, array in self.arrays.items()}
        object.__setattr__(self, "arrays", MappingProxyType(arrays))
        object.__setattr__(self, "dt", _time_step(self.dt))
        self._check_shapes()

    def __repr__(self) -> str:
        *_, anchors, steps, _ = self.trajectories.shape
        scenes = f"{len(self.trajectories)} scenes of " if self.batched else ""
        figures = [f"{scenes}{anchors} anchors of {steps} steps"]
        if (safe := self.arrays.get("safe")) is not None:
            figures.append(f"{safe.sum()} safe")
        if (routes := self.routes) is not None:
            figures.append(f"{routes.max(initial=-1) + 1} routes")
        ends = self.durations.min(), self.durations.max()
        figures.append(f"{' to '.join(dict.fromkeys(f'{each:.1f}' for each in ends))} s")
        if (total := self.timing_ms.get("total")) is not None:
            figures.append(f"planned in {total:.0f} ms")
        names = f"{self.model.name} {self.model.version}, seed {self.seed}"
        return f"<AnchorBatch: {', '.join(figures)}; {names}>"

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "arrays": dict(self.arrays)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        arrays, dt = state["arrays"], state["dt"]
        same = {
            "arrays": MappingProxyType({name: frozen(array) for name, array in arrays.items()}),
            "dt": frozen(dt) if isinstance(dt, np.ndarray) else dt,
        }
        for name, value in (state | same).items():
            object.__setattr__(self, name, value)

    def _check_shapes(self) -> None:
        shape = self.trajectories.shape
        if len(shape) not in (3, 4):
            raise ValueError(f"trajectories: expected [N,T,D] or [B,N,T,D], got {list(shape)}")
        for name in ARRAY_DTYPES:
            if name not in self.arrays:
                continue
            want = shape if name in MOTIONS else shape[:-2]
            came = self.arrays[name].shape
            if came != want:
                raise ValueError(f"{name}: expected shape {list(want)}, got {list(came)}")
        if np.ndim(self.dt) and np.shape(self.dt) != shape[:-2]:
            want, came = list(shape[:-2]), list(np.shape(self.dt))
            raise ValueError(f"dt: expected a number or shape {want}, got {came}")

    @property
    def trajectories(self) -> NDArray[np.floating]:
        """[N,T,D] m; the third of D = 3 is a heading in rad, its derivatives in rad/s and rad/s^2.

        float32, or float64 if they reach further than NEAR from zero.
        """
        return self.arrays["trajectories"]

    @property
    def velocities(self) -> NDArray[np.float32]:
        """[N,T,D] m/s. This and the next four raise `AbsentError` if the planner gives none."""
        return self._given("velocities")

    @property
    def accelerations(self) -> NDArray[np.float32]:
        """[N,T,D] m/s^2."""
        return self._given("accelerations")

    @property
    def scores(self) -> NDArray[np.float32]:
        """[N], higher is better."""
        return self._given("scores")

    @property
    def clearance(self) -> NDArray[np.float32]:
        """[N] m beyond robot_radius, smallest along the path."""
        return self._given("clearance")

    @property
    def safe(self) -> NDArray[np.bool_]:
        """[N], whether the path keeps robot_radius and certified_margin from every obstacle,
        certified_margin from the map's edge, and v_max and a_max. Of a car with `refine.guard`:
        whether it can be driven, stays on the perceived road and meets nobody."""
        return self._given("safe")

    @property
    def routes(self) -> NDArray[np.int64] | None:
        """[N], the way that each anchor takes, or None if the planner gives none.

        Anchors with the same number pass every obstacle, still or moving, on the same side.
        """
        return self.arrays.get("routes")

    @property
    def futures(self) -> NDArray[np.float32]:
        """[A,M,T,3] poses of the middles of the A others' boxes, in M modes, at the times of a plan
        without delay. This and the next raise `AbsentError` unless `outputs` named them."""
        return self._given(FUTURES)

    @property
    def future_probabilities(self) -> NDArray[np.float32]:
        """[A,M], of the modes of each of the others; zeros in unused rows."""
        return self._given(FUTURE_PROBABILITIES)

    @property
    def durations(self) -> NDArray[np.float64]:
        """[N] s from the first to the last time step, dt (T - 1); always an array."""
        *anchors, steps, _ = self.trajectories.shape
        return read_only(np.broadcast_to(np.asarray(self.dt) * (steps - 1), anchors))

    def _given(self, name: str) -> NDArray[Any]:
        if name not in self.arrays:
            given = ", ".join(self.arrays)
            raise AbsentError(f"{name}: {self.model.name} gives none; it gives {given}")
        return self.arrays[name]

    @property
    def batched(self) -> bool:
        """True if a B axis leads the arrays."""
        return self.trajectories.ndim == 4

    @property
    def best(self) -> NDArray[np.intp] | np.intp:
        """Index of the best safe anchor by score, or of the best if none is safe; [B].

        Without `safe` all are eligible, and without `scores` the first is the best.
        """
        return _best(self.arrays, self.trajectories.shape[:-2])

    def top_k(self, k: int, *, per_route: bool = False) -> NDArray[np.intp]:
        """Return the indices [k] of the best anchors by score, all safe ones before others; [B,k].

        There are fewer than k if N is less. As in `best`, all count as safe without `safe`, and
        without `scores` they keep their order.

        Args:
            k: at least 1.
            per_route: first the best anchor of each route, then their further ones; among the safe
                and then among the others.

        Raises:
            InvalidRequest: names `k` if it is no whole number from 1.
            AbsentError: per_route, and the planner gives no `routes`.
        """
        k = integer(k, "k", COUNT)
        shape = self.trajectories.shape[:-2]
        scores = self.arrays.get("scores", np.zeros(shape))
        unsafe = ~self.arrays.get("safe", np.ones(shape, np.bool_))
        order = np.lexsort((-scores, unsafe))
        if per_route:
            routes = np.take_along_axis(self._given("routes"), order, axis=-1)
            later = np.apply_along_axis(_seen_before, -1, routes)
            unsafe = np.take_along_axis(unsafe, order, axis=-1)
            order = np.take_along_axis(order, np.lexsort((later, unsafe)), axis=-1)
        return order[..., :k]

    def best_along(self, route: ArrayLike, *, within: float = 2.0) -> int:
        """Return the index of the best anchor that follows a route, for a caller who knows one.

        An anchor follows the route if it ends within `within` of it. If none of them moves by a
        metre, the index is `best`, as a robot that waits beside a route does not follow it.

        Args:
            route: [V, 2] m, a polyline in the request's frame, as far as the robot can get in the
                time of an anchor; ends beyond its end count as beside it.
            within: m

        Raises:
            InvalidRequest: names `route` if it is not two or more finite points, or `within` if
                that is negative or not finite.
            UsageError: the answer is of several scenes.
        """
        if self.batched:
            raise UsageError("best_along: expected the answer of one scene, got a B axis")
        within = number(within, "within", WITHIN)
        strays = beside_route(self.trajectories[:, -1, :2], route)
        ways = self.trajectories[..., :2]
        moves = np.linalg.norm(ways - ways[:, :1], axis=-1).max(-1) > MIN_MOVE
        follows = strays <= within
        kept = np.flatnonzero(follows if (follows & moves).any() else np.ones_like(follows))
        names = [name for name in ("scores", "safe") if name in self.arrays]
        return int(kept[_best({name: self.arrays[name][kept] for name in names}, kept.shape)])

    @property
    def is_finite(self) -> bool:
        """True if every number is finite."""
        if not all(map(math.isfinite, (self.first_s, *self.timing_ms.values()))):
            return False
        numbers = (*self.arrays.values(), np.asarray(self.dt))
        return all(
            np.isfinite(values).all() for values in numbers if values.dtype.kind not in "biu"
        )

    def told(self, *, timing_ms: Mapping[str, float], request_id: str | None) -> AnchorBatch:
        """Return the same anchors for another request, without checking them again."""
        same = copy(self)
        object.__setattr__(same, "timing_ms", timing_ms)
        object.__setattr__(same, "request_id", request_id)
        return same


def _best(arrays: Mapping[str, NDArray[Any]], shape: tuple[int, ...]) -> NDArray[np.intp] | np.intp:
    """Return `AnchorBatch.best` for anchors of a shape [N] or [B,N]."""
    scores = arrays.get("scores", np.zeros(shape))
    safe = arrays.get("safe", np.ones(shape, np.bool_))
    eligible = safe | ~safe.any(axis=-1, keepdims=True)
    return np.where(eligible, scores, -np.inf).argmax(axis=-1)


def _seen_before(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Return element by element [N] whether an earlier one is equal."""
    before = np.ones(len(values), np.bool_)
    before[np.unique(values, return_index=True)[1]] = False
    return before


def _time_step(dt: Any) -> float | NDArray[np.float64]:
    """Return one number as a float, several as a read-only array."""
    steps = np.asarray(dt, dtype=np.float64)
    if (steps <= 0.0).any():
        raise ValueError(f"dt: expected s above 0, got {steps.min():g}")
    return read_only(steps) if steps.ndim else float(steps)


def _typed(name: str, array: Any) -> NDArray[Any]:
    """Return an array in the contract's type; extras keep their own."""
    array = np.asarray(array)
    dtype = ARRAY_DTYPES.get(name, array.dtype)
    if name == "trajectories" and np.abs(array).max(initial=0.0) > NEAR:
        dtype = np.float64
    return np.asarray(array, dtype=dtype)


SHORTEST = 1e-9  # m², a segment's length squared below which it is a point


def beside_route(points: NDArray[np.floating], route: ArrayLike) -> NDArray[np.float64]:
    """Return m [...] from points [..., 2] to a polyline [V, 2]. Raises `InvalidRequest`."""
    line = polyline(route)
    start, along = line[:-1], np.diff(line, axis=0)
    length = np.maximum((along**2).sum(-1), SHORTEST)
    offset = np.asarray(points, np.float64)[..., None, :] - start
    share = np.clip((offset * along).sum(-1) / length, 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * along, axis=-1).min(-1)


def polyline(route: ArrayLike) -> NDArray[np.float64]:
    """Read a route [V, 2]. Raises `InvalidRequest` if it is not two or more finite points."""
    line = as_array(route, "route", np.float64)
    if line.ndim != 2 or line.shape[0] < 2 or line.shape[1] != 2 or not np.isfinite(line).all():
        what = "expected two or more finite points [V, 2]"
        came = f"shape {list(line.shape)}" if np.isfinite(line).all() else "some that are not"
        raise InvalidRequest(f"{what}, got {came}", "route")
    return line
