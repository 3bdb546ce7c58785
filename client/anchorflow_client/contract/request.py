"""The request: a map, a state and a goal, or named inputs, and what may be chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.body import Kinematics, read_footprint
from anchorflow_client.contract.checks import (
    EVERY_NUMBER,
    expected,
    fields_of,
    read_only,
    vectors,
    within,
)
from anchorflow_client.contract.cost_map import CostMap
from anchorflow_client.contract.fields import (
    DEFAULT_MODEL,
    DEFAULT_STYLE,
    DIMENSIONS,
    GOAL_FIELDS,
    MAP_FIELDS,
    MAX_SCENES,
    NUM_STYLE,
    OCCUPIED,
    OPTIONS,
    REQUEST,
    STATE_FIELDS,
    STYLES,
    GoalTolerance,
    RefineChoice,
    SamplerChoice,
    WarmStart,
)
from anchorflow_client.contract.hints import degrees_hint, place_hint, resolution_hint
from anchorflow_client.contract.inputs import Inputs, read_inputs
from anchorflow_client.contract.obstacles import Obstacles
from anchorflow_client.contract.ranges import STATE, STYLE_WEIGHT
from anchorflow_client.contract.rows import with_rows
from anchorflow_client.errors import InvalidRequest

SMALL_ROBOT, CELLS_OF_A_ROBOT = 0.25, 16
"""Radius [m], and how many of it, or of a larger robot's, a cell is at most."""


@dataclass(frozen=True, eq=False)
class MapScenes:
    """The scenes of a request to a planner with a cost map, all with the same leading B."""

    cost_map: CostMap
    x_curr: NDArray[np.float64]
    """[B,3D] position in m, velocity in m/s, acceleration in m/s^2; D = 2, or 3 with heading."""
    x_goal: NDArray[np.float64]
    """[B,2D] position in m, velocity in m/s."""
    w_style: NDArray[np.float64]
    """[B,3] safety, energy, smooth; sums to 1."""

    @property
    def dim(self) -> int:
        """D, components of a position: 2, or 3 with heading."""
        return self.x_curr.shape[-1] // STATE_FIELDS


@dataclass(frozen=True, kw_only=True, eq=False)
@with_rows(OPTIONS)
class AnchorRequest:
    """A checked request; None leaves a field to the model card. SI units."""

    map_scenes: MapScenes | None = None
    """For a planner with a cost map, in the map's frame."""
    inputs: Inputs = field(default_factory=dict)
    """For any other planner, by the names of its card; [B,…] once they are bound to the card."""
    outputs: tuple[str, ...] = ()
    num_samples: int | None = None
    robot_radius: float | None = None
    footprint: NDArray[np.float64] | None = None
    kinematics: Kinematics | None = None
    v_max: float | None = None
    a_max: float | None = None
    horizon_s: float | None = None
    cost_penalty: float | None = None
    clear_start: bool | None = None
    goal_tolerance: GoalTolerance | None = None
    obstacles: Obstacles | None = None
    model: str | None = None
    seed: int | None = None
    sampler: SamplerChoice | None = None
    refine: RefineChoice | None = None
    warm_start: WarmStart | None = None
    budget_ms: float | None = None
    robot_id: str | None = None
    delay_s: float | None = None
    last_plan: NDArray[np.float64] | None = None
    """[K,4] time in s, x, y in m, heading in rad."""
    num_scenes: int = 1
    """B."""
    batched: bool = False
    """False: there is one scene, and the answer has no B axis."""
    request_id: str | None = None

    @classmethod
    def build(
        cls,
        *,
        cost_map: CostMap | Mapping[str, Any] | None = None,
        x_curr: ArrayLike | None = None,
        x_goal: ArrayLike | None = None,
        **optional: Any,
    ) -> AnchorRequest:
        """Check the fields of the JSON contract and convert them to arrays.

        Args:
            cost_map: a CostMap, or {"data", "resolution", "origin"}; None for a planner that
                takes `inputs`.
            x_curr: [3D] or [B,3D]; its length determines whether D is 2 or 3.
            x_goal: [2D] or [B,2D].
            **optional: the other fields of `fields.REQUEST`; None leaves one out.

        Raises:
            InvalidRequest: names the field by its JSON path, what was expected and what came.
        """
        on_map = {"cost_map": cost_map, "x_curr": x_curr, "x_goal": x_goal}
        fields_of(optional, "", OPTIONS)
        options = {name: value for name, value in optional.items() if value is not None}
        inputs = read_inputs(options.pop("inputs", {}))
        if all(value is None for value in on_map.values()):
            if not inputs:
                *first, last = MAP_FIELDS
                either = f"{', '.join(first)} and {last}, or inputs"
                raise InvalidRequest(f"expected {either}, got none of them", "body")
            request = cls(inputs=inputs, **_options(options, dim=None))
        else:
            fields_of(on_map, "", MAP_FIELDS, MAP_FIELDS)
            style = options.pop("w_style", DEFAULT_STYLE)
            scenes, batched = _scenes(cost_map, x_curr, x_goal, style)
            request = cls(
                map_scenes=scenes,
                inputs=inputs,
                num_scenes=len(scenes.x_curr),
                batched=batched,
                **_options(options, scenes.dim),
            )
            _check_places(request)
        schedule = request.sampler and request.sampler.schedule
        if schedule and request.warm_start is None and schedule[0] != 0.0:
            message = f"expected a first time of 0 without a warm start, got {schedule[0]:g}"
            raise InvalidRequest(message, "sampler.schedule")
        return request

    @classmethod
    def from_fields(cls, body: Any) -> AnchorRequest:
        """Build a request from parsed, untrusted JSON. Raises `InvalidRequest`."""
        return cls.build(**fields_of(body, "", REQUEST.fields))

    @property
    def has_body(self) -> bool:
        """Whether it asks for poses: it has a footprint, or wheels."""
        wheels = self.kinematics is not None and self.kinematics.kind != "omni"
        return wheels or self.footprint is not None

    @property
    def on_map(self) -> MapScenes:
        """The scenes of a planner with a cost map. Raises `InvalidRequest` if there are none."""
        if self.map_scenes is None:
            raise InvalidRequest("this field is required by a planner with a cost map", "cost_map")
        return self.map_scenes

    @property
    def cost_map(self) -> CostMap:
        """The cost map of `on_map`."""
        return self.on_map.cost_map

    @property
    def x_curr(self) -> NDArray[np.float64]:
        """[B,3D]."""
        return self.on_map.x_curr

    @property
    def x_goal(self) -> NDArray[np.float64]:
        """[B,2D]."""
        return self.on_map.x_goal

    @property
    def w_style(self) -> NDArray[np.float64]:
        """[B,3]."""
        return self.on_map.w_style

    def field_values(self) -> dict[str, Any]:
        """Return all fields by name, without a copy."""
        return dict(vars(self))


def _scenes(cost_map: Any, x_curr: Any, x_goal: Any, w_style: Any) -> tuple[MapScenes, bool]:
    """Return the scenes, and whether any of the arrays was batched."""
    cost_map = CostMap.from_fields(cost_map)
    x_curr = read_states(x_curr, "x_curr", STATE_FIELDS, *DIMENSIONS)
    dim = x_curr.shape[-1] // STATE_FIELDS
    arrays = {
        "cost_map.data": cost_map.data,
        "x_curr": x_curr,
        "x_goal": read_states(x_goal, "x_goal", GOAL_FIELDS, dim),
        "w_style": _style(w_style),
    }
    batches = {name: len(array) for name, array in arrays.items() if array.ndim in (2, 4)}
    num_scenes = _common_num_scenes(batches)
    grid, start, goal, style = (
        read_only(array if name in batches else _over_scenes(array, num_scenes))
        for name, array in arrays.items()
    )
    cost_map = replace(cost_map, data=grid)
    return MapScenes(cost_map, start, goal, style), bool(batches)


def _over_scenes(array: NDArray[Any], num_scenes: int) -> NDArray[Any]:
    """Repeat an array for every scene: [B,…] with a stride of 0."""
    alone = array[None]
    # broadcast_to is slower, and most requests have one scene.
    return alone if num_scenes == 1 else np.broadcast_to(alone, (num_scenes, *array.shape))


def read_states(value: Any, field: str, parts: int, *dims: int) -> NDArray[np.float64]:
    """Read one or a batch of position, velocity and so on to `parts` D-vectors, D of `dims`."""
    states = vectors(value, field, EVERY_NUMBER, *(parts * dim for dim in dims))
    dim = states.shape[-1] // parts
    for part in range(parts):
        within(states, field, STATE[part], part=slice(part * dim, (part + 1) * dim))
    if dim == DIMENSIONS[-1] and (hint := degrees_hint(states[..., dim - 1])):
        raise InvalidRequest(f"expected a heading in rad{hint}", field)
    return states


def _common_num_scenes(batches: Mapping[str, int]) -> int:
    """Return the B on which the batched fields must agree; 1 if none is batched."""
    for name, size in batches.items():
        if not 1 <= size <= MAX_SCENES:
            raise InvalidRequest(f"expected B from 1 to {MAX_SCENES}, got {size}", name)
        first = next(iter(batches))
        if size != batches[first]:
            raise InvalidRequest(f"expected B = {batches[first]} as in {first}, got {size}", name)
    return next(iter(batches.values()), 1)


def _style(value: Any) -> NDArray[np.float64]:
    """Read weights, or the name of a style, and scale them to sum to 1."""
    if isinstance(value, str):
        if value not in STYLES:
            names = ", ".join(STYLES)
            raise expected("w_style", f"weights [3] or [B,3], or one of {names}", value)
        value = STYLES[value]
    weights = vectors(value, "w_style", STYLE_WEIGHT, NUM_STYLE)
    rows: list[list[float]] = weights.reshape(-1, NUM_STYLE).tolist()
    if all(abs(safety + energy + smooth - 1) < 1e-12 for safety, energy, smooth in rows):
        return weights  # unchanged, so that client and service agree to the last bit
    total = weights.sum(axis=-1, keepdims=True)
    if not (total > 0).all():
        raise InvalidRequest("expected a weight above 0, got only zeros", "w_style")
    return np.where(np.abs(total - 1) < 1e-12, weights, weights / total)


def _check_places(request: AnchorRequest) -> None:
    """Refuse cells far wider than the robot, and a start or goal off the map or in an obstacle.

    The latter unless the request allows it.
    """
    cost_map = request.cost_map
    most = CELLS_OF_A_ROBOT * max(request.robot_radius or 0.0, SMALL_ROBOT)
    if cost_map.resolution > most and request.footprint is None:
        message = f"expected cells of at most {most:g} m for this robot, got"
        hint = resolution_hint(cost_map.resolution)
        raise InvalidRequest(f"{message} {cost_map.resolution:g}{hint}", "cost_map.resolution")
    occupancy = cost_map.occupancy
    # Among what moves a disc's goal moves to where it can be reached.
    goal_moves = request.obstacles is not None and not request.has_body
    goal_moves = goal_moves or request.goal_tolerance is not None
    may_be_occupied = {"x_curr": request.clear_start, "x_goal": goal_moves}
    for name, allowed in may_be_occupied.items():
        points = getattr(request, name)[:, :2]
        for scene, (x, y) in enumerate(points.tolist()):
            position = f"({x:g}, {y:g}) m of scene {scene}"
            if not cost_map.contains(x, y):
                (x_low, y_low), (x_high, y_high) = low, high = cost_map.extent
                extent = f"x from {x_low:g} to {x_high:g} m and y from {y_low:g} to {y_high:g} m"
                message = f"expected a position on the map ({extent}), got {position}"
                hint = place_hint(x, y, low=low, high=high, resolution=cost_map.resolution)
                raise InvalidRequest(message + hint, name)
            row, column = cost_map.cell_of(x, y)
            if (came := occupancy[scene, row, column]) >= OCCUPIED and not allowed:
                message = f"expected a cell of occupancy below {OCCUPIED}, got {position}"
                cell = f"in cell [row {row}, column {column}] of occupancy {came:.2g}"
                nearest = _nearest_free(cost_map, occupancy[scene], x, y)
                hint = resolution_hint(cost_map.resolution)
                raise InvalidRequest(f"{message} {cell}; {nearest}{hint}", name)


def _nearest_free(cost_map: CostMap, occupancy: NDArray[np.float32], x: float, y: float) -> str:
    """Say where the nearest free cell is to a point in m."""
    rows, columns = np.nonzero(occupancy < OCCUPIED)
    if not len(rows):
        return "no cell of the map is free"
    centres = cost_map.origin + cost_map.resolution * (np.stack([columns, rows], -1) + 0.5)
    nearest = np.hypot(*(centres - (x, y)).T).argmin()
    return "the nearest free one is at ({:g}, {:g}) m".format(*centres[nearest].round(6))


_READERS: dict[str, Callable[[Any], Any]] = {
    **{name: partial(row.read, path=name) for name, row in OPTIONS.items()},
    "sampler": SamplerChoice.from_fields,
    "refine": RefineChoice.from_fields,
    "goal_tolerance": GoalTolerance.from_fields,
    "obstacles": Obstacles.from_fields,
    "footprint": read_footprint,
    "kinematics": Kinematics.from_fields,
}


def _options(options: Mapping[str, Any], dim: int | None) -> dict[str, Any]:
    """Check the optional fields of a request; `dim` is None if it has no state."""
    readers = _READERS
    if dim is None:
        for name in ("w_style", "warm_start"):
            if name in options:
                raise InvalidRequest("expected none for a planner without a cost map", name)
    elif "warm_start" in options:
        readers = readers | {"warm_start": partial(WarmStart.from_fields, dim=dim)}
    read = {name: readers[name](value) for name, value in options.items()}
    if read.get("model") == DEFAULT_MODEL:
        del read["model"]
    return read
