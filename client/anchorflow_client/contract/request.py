"""The request: a map, a state, a goal, and what may be chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import ranges
from anchorflow_client.contract.arrays import read_only, vectors
from anchorflow_client.contract.checks import fields_of, integer, number, text
from anchorflow_client.contract.cost_map import CostMap
from anchorflow_client.contract.ranges import Interval
from anchorflow_client.contract.sampling import RefineChoice, SamplerChoice, WarmStart
from anchorflow_client.errors import InvalidRequest

REQUIRED_FIELDS = ("cost_map", "x_curr", "x_goal")
OPTIONAL_FIELDS = (
    "w_style",
    "num_samples",
    "robot_radius",
    "v_max",
    "a_max",
    "horizon_s",
    "model",
    "seed",
    "sampler",
    "refine",
    "warm_start",
    "budget_ms",
    "robot_id",
    "request_id",
)
FIELDS = REQUIRED_FIELDS + OPTIONAL_FIELDS

LIMIT_INTERVALS: dict[str, Interval] = {
    "robot_radius": ranges.ROBOT_RADIUS,
    "v_max": ranges.V_MAX,
    "a_max": ranges.A_MAX,
    "horizon_s": ranges.HORIZON,
}
"""The limits that a request may state; a card may fix them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AnchorRequest:
    """A request that holds together; None leaves a field to the model card. SI units, map frame."""

    cost_map: CostMap
    x_curr: NDArray[np.float64]
    """[B,3D] position in m, velocity in m/s, acceleration in m/s^2; D = 2, or 3 with heading."""
    x_goal: NDArray[np.float64]
    """[B,2D] position in m, velocity in m/s."""
    w_style: NDArray[np.float64]
    """[B,3] safety, energy, smooth; sums to 1."""
    num_samples: int = ranges.DEFAULT_NUM_SAMPLES
    """N, anchors a scene."""
    robot_radius: float | None = None
    """m."""
    v_max: float | None = None
    """m/s."""
    a_max: float | None = None
    """m/s^2."""
    horizon_s: float | None = None
    model: str | None = None
    seed: int | None = None
    sampler: SamplerChoice | None = None
    refine: RefineChoice | None = None
    warm_start: WarmStart | None = None
    budget_ms: float | None = None
    """Time left to the caller, counted from arrival."""
    robot_id: str | None = None
    """Who asks: a newer request of the same robot takes the place of one that is not answered."""
    batched: bool = False
    """False: there is one scene, and the answer has no B axis."""
    request_id: str | None = None

    @classmethod
    def build(
        cls,
        *,
        cost_map: CostMap | Mapping[str, Any],
        x_curr: ArrayLike,
        x_goal: ArrayLike,
        **optional: Any,
    ) -> AnchorRequest:
        """Check the fields of the JSON contract and bring them to their arrays.

        Args:
            cost_map: a CostMap, or {"data", "resolution", "origin"}.
            x_curr: [3D] or [B,3D]; its length says whether D is 2 or 3.
            x_goal: [2D] or [B,2D].
            **optional: the further fields of this class; None stands for one that is left out.

        Raises:
            InvalidRequest: names the field by its JSON path, what was expected and what came.
        """
        options = fields_of(optional, "", OPTIONAL_FIELDS)
        scenes = _scenes(cost_map, x_curr, x_goal, options.get("w_style"))
        request = cls(**scenes._asdict(), **_options(options, _dim_of(scenes.x_curr)))
        _check_first_time(request)
        return request

    @classmethod
    def from_fields(cls, body: Any) -> AnchorRequest:
        """The same out of a parsed JSON body, from which fields may be missing or strange."""
        return cls.build(**fields_of(body, "", FIELDS, REQUIRED_FIELDS))

    @property
    def num_scenes(self) -> int:
        """B."""
        return len(self.x_curr)

    @property
    def dim(self) -> int:
        """D, dimensions of a position: 2, or 3 with heading."""
        return _dim_of(self.x_curr)

    def field_values(self) -> dict[str, Any]:
        """All fields by name, not copied."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class _Scenes(NamedTuple):
    """The arrays of a request, all with the same leading B."""

    cost_map: CostMap
    x_curr: NDArray[np.float64]
    x_goal: NDArray[np.float64]
    w_style: NDArray[np.float64]
    batched: bool


def _dim_of(x_curr: NDArray[np.float64]) -> int:
    """D of states [...,3D]."""
    return x_curr.shape[-1] // ranges.STATE_FIELDS


def _scenes(cost_map: Any, x_curr: Any, x_goal: Any, w_style: Any) -> _Scenes:
    cost_map = CostMap.from_fields(cost_map)
    state_sizes = (ranges.STATE_FIELDS * dim for dim in ranges.DIMENSIONS)
    x_curr = vectors(x_curr, "x_curr", ranges.STATE, *state_sizes)
    arrays = {
        "cost_map.data": cost_map.data,
        "x_curr": x_curr,
        "x_goal": vectors(x_goal, "x_goal", ranges.STATE, ranges.GOAL_FIELDS * _dim_of(x_curr)),
        "w_style": _style(ranges.DEFAULT_STYLE if w_style is None else w_style),
    }
    batches = {name: len(array) for name, array in arrays.items() if array.ndim in (2, 4)}
    num_scenes = _common_num_scenes(batches)
    grid, start, goal, style = (
        read_only(np.broadcast_to(array, (num_scenes, *array.shape[name in batches :])))
        for name, array in arrays.items()
    )
    cost_map = CostMap(grid, cost_map.resolution, cost_map.origin)
    _check_on_free_cells(cost_map, start[:, :2], "x_curr")
    _check_on_free_cells(cost_map, goal[:, :2], "x_goal")
    return _Scenes(cost_map, start, goal, style, batched=bool(batches))


def _common_num_scenes(batches: Mapping[str, int]) -> int:
    """B of the batched fields, which must agree; 1 where none is batched."""
    for name, size in batches.items():
        if not 1 <= size <= ranges.MAX_SCENES:
            raise InvalidRequest(f"expected B from 1 to {ranges.MAX_SCENES}, got {size}", name)
        first = next(iter(batches))
        if size != batches[first]:
            raise InvalidRequest(f"expected B = {batches[first]} as in {first}, got {size}", name)
    return next(iter(batches.values()), 1)


def _style(value: Any) -> NDArray[np.float64]:
    """Weights made to sum to 1."""
    weights = vectors(value, "w_style", ranges.STYLE_WEIGHT, ranges.NUM_STYLE)
    total = weights.sum(axis=-1, keepdims=True)
    if not (total > 0).all():
        raise InvalidRequest("expected a weight above 0, got only zeros", "w_style")
    # Weights that sum to 1 already stay as they are, so that client and service agree to the bit.
    return np.where(np.abs(total - 1) < 1e-12, weights, weights / total)


def _check_on_free_cells(cost_map: CostMap, points: NDArray[np.float64], field: str) -> None:
    """Refuse points [B,2] off the map or in an occupied cell of their own scene."""
    rows, columns = cost_map.cells_of(points).T
    occupancy = cost_map.occupancy[np.arange(len(points)), rows, columns]
    inside = cost_map.contains(points)
    refused = ~inside | (occupancy >= ranges.OCCUPIED)
    if not refused.any():
        return
    scene = int(refused.argmax())
    if not inside[scene]:
        raise InvalidRequest(_off_map(cost_map, points[scene], scene), field)
    cell = f"cell [row {rows[scene]}, column {columns[scene]}]"
    came = f"{_position(points[scene], scene)} in {cell} of occupancy {occupancy[scene]:.2g}"
    raise InvalidRequest(f"expected a cell of occupancy below {ranges.OCCUPIED}, got {came}", field)


def _off_map(cost_map: CostMap, point: NDArray[np.float64], scene: int) -> str:
    (x_low, y_low), (x_high, y_high) = cost_map.extent
    extent = f"x from {x_low:g} to {x_high:g} m and y from {y_low:g} to {y_high:g} m"
    return f"expected a position on the map ({extent}), got {_position(point, scene)}"


def _position(point: NDArray[np.float64], scene: int) -> str:
    return f"({point[0]:g}, {point[1]:g}) m of scene {scene}"


def _options(options: Mapping[str, Any], dim: int) -> dict[str, Any]:
    """Check the optional fields that need no scene beside D = `dim`."""
    checks = _CHECK_OF_OPTION | {"warm_start": partial(WarmStart.from_fields, dim=dim)}
    return {
        name: check(options[name])
        for name, check in checks.items()
        if options.get(name) is not None
    }


_CHECK_OF_OPTION: dict[str, Callable[[Any], Any]] = {
    **{
        name: partial(number, field=name, interval=interval)
        for name, interval in LIMIT_INTERVALS.items()
    },
    "num_samples": partial(integer, field="num_samples", interval=ranges.NUM_SAMPLES),
    "model": partial(text, field="model"),
    "seed": partial(integer, field="seed", interval=ranges.SEED),
    "sampler": SamplerChoice.from_fields,
    "refine": RefineChoice.from_fields,
    "budget_ms": partial(number, field="budget_ms", interval=ranges.BUDGET),
    "robot_id": partial(text, field="robot_id"),
    "request_id": partial(text, field="request_id"),
}


def _check_first_time(request: AnchorRequest) -> None:
    """Without a warm start the flow begins in noise, at t = 0."""
    schedule = request.sampler and request.sampler.schedule
    if schedule and request.warm_start is None and schedule[0] != 0.0:
        message = f"expected a first time of 0 without a warm start, got {schedule[0]:g}"
        raise InvalidRequest(message, "sampler.schedule")
