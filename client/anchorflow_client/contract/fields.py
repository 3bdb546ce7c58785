"""The table of request fields: name, shape, unit, range, default and meaning, each written once.

`REQUEST` holds one row for each field of a request. The checks of `AnchorRequest`, the keywords of
`plan` and `Planner.update`, the tensors of the binary form, /openapi.json (and with it the form of
the service's page) and the reference are all made from it. A new field is a new row, plus the code
that uses it.
"""

# No `from __future__ import annotations`: the rows are read out of the annotations below.
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any, TypedDict, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.body import FOOTPRINT, KINEMATICS, Kinematics
from anchorflow_client.contract.checks import Interval, numbers, read_only, wrong_shape
from anchorflow_client.contract.obstacles import OBSTACLES, Obstacles
from anchorflow_client.contract.ranges import (
    A_MAX,
    ACCELERATION,
    BUDGET,
    CERTIFIED_MARGIN,
    CHANNEL_WEIGHT,
    COORDINATE,
    COST_PENALTY,
    DELAY,
    GOAL_DISTANCE,
    GOAL_TURN,
    GUIDANCE,
    HORIZON,
    INSIDE_UNIT,
    NUM_SAMPLES,
    RESOLUTION,
    ROBOT_RADIUS,
    SEED,
    STYLE_WEIGHT,
    UNIT,
    V_MAX,
    VELOCITY,
    WARM_STATE,
)
from anchorflow_client.contract.rows import (
    MAX_SCHEDULE_STEPS,
    MIN_STEP,
    Array,
    Flag,
    FlowTimes,
    Group,
    Inputs,
    Names,
    Number,
    Row,
    Text,
    TimedPoses,
    rows_of,
)

DIMENSIONS = (2, 3)
"""D: x and y, or x, y and heading."""
STATE_FIELDS = 3
"""D-vectors of `x_curr`: position, velocity, acceleration."""
GOAL_FIELDS = 2
"""D-vectors of `x_goal`: position and velocity."""
NUM_STYLE = 3
"""Weights of `w_style`: safety, energy, smooth."""
DEFAULT_NUM_SAMPLES = 64
DEFAULT_TAU = 0.8
DEFAULT_MODEL = "default"
"""A name for the model that a request without a name gets."""
DEFAULT_COST_PENALTY = 3.0
METHODS = ("rk4", "heun", "midpoint", "euler", "ab2")
"""ab2 is the method of Adams and Bashforth of order 2."""
OCCUPIED = 0.5
"""Occupancy from which on a cell is an obstacle."""
STYLES: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "conservative": (0.7, 0.1, 0.2),  # far from obstacles, and slow
        "balanced": (0.4, 0.3, 0.3),
        "efficient": (0.2, 0.5, 0.3),  # short and quick
        "comfortable": (0.3, 0.2, 0.5),  # little jerk
    }
)
"""Weights of safety, energy and smoothness by the name of the style."""
DEFAULT_STYLE = STYLES["balanced"]

MAX_SCENES = 64
MAX_CHANNELS = 16
MIN_MAP_CELLS, MAX_MAP_CELLS = 16, 512
"""Least and most cells along a side of the map."""
MAX_WARM_START_STEPS = 1024
MAX_LAST_PLAN_STEPS = 256
MAX_INPUT_TEXT_LENGTH = 64 * 1024
"""Characters of an input that is a text, such as a prompt."""
MAX_PIXELS = 16 * 2**20
"""Pixels of one picture; a file of a few kB may unpack to gigabytes."""
MAX_REQUEST_PIXELS = 2 * MAX_PIXELS
"""Pixels of all pictures of one request, such as the two of V2X-VLM."""

COST_MAP = Group(
    "What the robot knows of the space around it; rows grow with y, columns with x.",
    {
        "data": Array(
            "Channel 0 is obstacle occupancy (0.5 and above), 1 traversability, 2 risk, from 3 on "
            "further soft costs.",
            "[C,H,W] or [B,C,H,W]",
            ((1, MAX_CHANNELS), (MIN_MAP_CELLS, MAX_MAP_CELLS), (MIN_MAP_CELLS, MAX_MAP_CELLS)),
            UNIT,
            tensor="cost_map",
            batched=True,
            required=True,
            objects=("png",),
        ),
        "resolution": Number("Size of a cell.", RESOLUTION, required=True),
        "origin": Array(
            "Outer corner of cell (0, 0); by default the map is centred on 0.",
            "[2]",
            ((2, 2),),
            COORDINATE,
            unit="m",
        ),
        "channel_weights": Array(
            "Factors of the soft costs of channels 1 to C - 1, each 1 by default.",
            "[C-1]",
            ((0, MAX_CHANNELS - 1),),
            CHANNEL_WEIGHT,
            tensor="channel_weights",
        ),
    },
)
Spec = TypeVar("Spec")
OwnChoice = TypeVar("OwnChoice", bound="CardChoice")


class CardChoice:
    """Fields of a request that replace those of a card; None leaves a field to the card."""

    @classmethod
    def from_fields(cls: type[OwnChoice], value: Any) -> OwnChoice:
        name, rows = ("sampler", SAMPLER) if issubclass(cls, SamplerChoice) else ("refine", REFINE)
        return cls(**rows.read(value.given if isinstance(value, cls) else value, name))

    @property
    def given(self) -> dict[str, Any]:
        """Return the fields that are not left to the card."""
        rows = SAMPLER if isinstance(self, SamplerChoice) else REFINE
        asked = {name: getattr(self, name) for name in rows.fields}
        return {name: value for name, value in asked.items() if value is not None}

    def over(self, card: Spec) -> Spec:
        """Return the card's sampler, or refinement, with this choice."""
        return replace(card, **self.given)  # type: ignore[type-var]


@dataclass(frozen=True)
class SamplerChoice(CardChoice):
    """The solver of the flow and the times it visits."""

    method: Annotated[str | None, Text("Method of integration.", METHODS)] = None
    schedule: Annotated[
        tuple[float, ...] | None,
        FlowTimes(
            f"Flow times from 0 (noise) to 1 (data), at least {MIN_STEP:g} apart; the first is 0 "
            "without a warm start.",
            "[K]",
            ((2, MAX_SCHEDULE_STEPS + 1),),
            UNIT,
            tensor="schedule",
            words=("8step",),
            objects=("uniform",),
        ),
    ] = None


@dataclass(frozen=True)
class RefineChoice(CardChoice):
    """The refinement of samples."""

    smooth: Annotated[bool | None, Flag("Fit the spline with fixed ends.")] = None
    project: Annotated[
        bool | None, Flag("Push anchors out of obstacles and inside the limits.")
    ] = None
    safety_margin: Annotated[
        float | None,
        Number(
            "Distance beyond robot_radius that the projection aims at.", Interval(0.0, 5.0, "m")
        ),
    ] = None
    guidance: Annotated[
        float | None, Number("Scale of the cost gradient inside the flow; 0 is off.", GUIDANCE)
    ] = None
    barrier: Annotated[
        bool | None, Flag("Correct anchors that are still too near by a control barrier.")
    ] = None
    certified_margin: Annotated[
        float | None,
        Number(
            "Distance beyond robot_radius that every anchor called safe keeps.", CERTIFIED_MARGIN
        ),
    ] = None
    guard: Annotated[
        bool | None,
        Flag("Say which trajectories of a car are safe, and make the last of them a stop."),
    ] = None
    route_drives: Annotated[
        bool | None,
        Flag("Put drives along the route first, ordered by what the planner perceives."),
    ] = None


@dataclass(frozen=True, eq=False)
class WarmStart:
    """A trajectory to start from, at flow time `tau`, in place of noise."""

    trajectory: Annotated[
        NDArray[np.float64],
        Array(
            "Positions [m], then velocities [m/s], then accelerations [m/s^2]; D is the model's.",
            "[T,D], [T,2D] or [T,3D]",
            ((2, MAX_WARM_START_STEPS), (2, 9)),
            WARM_STATE,
            tensor="warm_start",
            required=True,
        ),
    ]
    tau: Annotated[
        float,
        Number(
            "Flow time to start at; near 1 the answer stays near the trajectory.",
            INSIDE_UNIT,
            default=DEFAULT_TAU,
        ),
    ]
    dt: Annotated[
        float | None,
        Number(
            "Time between two samples; by default the trajectory lasts horizon_s or, without one, "
            "as long as the model estimates.",
            Interval(0.0, 600.0, "s", open_low=True),
        ),
    ] = None

    @classmethod
    def from_fields(cls, value: Any, *, dim: int) -> "WarmStart":
        """Check the JSON object beside states of D = `dim`."""

        def trajectory(value: Any, path: str) -> NDArray[np.float64]:
            most = STATE_FIELDS * dim
            shape = f"[T,{dim}] to [T,{most}]"
            states = numbers(value, path, WARM_STATE, shape)
            steps, size = states.shape if states.ndim == 2 else (0, 0)
            if not (2 <= steps <= MAX_WARM_START_STEPS and dim <= size <= most):
                raise wrong_shape(path, shape, states)
            return read_only(states)

        value = vars(value) if isinstance(value, WarmStart) else value
        asked: dict[str, Any] = {"tau": DEFAULT_TAU}
        return cls(**(asked | WARM_START.read(value, "warm_start", trajectory=trajectory)))


@dataclass(frozen=True)
class GoalTolerance:
    """How far from `x_goal` anchors may end if the goal is occupied or cannot be reached."""

    position: Annotated[
        float, Number("Distance to the goal that is near enough.", GOAL_DISTANCE, required=True)
    ]
    heading: Annotated[
        float | None,
        Number("Angle to the goal's heading that is near enough; any by default.", GOAL_TURN),
    ] = None

    @classmethod
    def from_fields(cls, value: Any) -> "GoalTolerance":
        value = vars(value) if isinstance(value, GoalTolerance) else value
        return cls(**GOAL_TOLERANCE.read(value, "goal_tolerance"))


SAMPLER = Group("The solver of the flow; fields left out are the card's.", rows_of(SamplerChoice))
REFINE = Group("The refinement of samples; fields left out are the card's.", rows_of(RefineChoice))
GOAL_TOLERANCE = Group(
    "If the goal is occupied or cannot be reached, the nearest place that can be reached takes its "
    "place; by default such a goal is refused.",
    rows_of(GoalTolerance),
)
WARM_START = Group("A trajectory to start from in place of noise.", rows_of(WarmStart))


MAP_FIELDS: dict[str, Row] = {
    "cost_map": COST_MAP,
    "x_curr": Array(
        f"Position [m], velocity {VELOCITY}, acceleration {ACCELERATION}, each x and y; with "
        "D = 3 each x, y and heading [rad], which runs on beyond pi.",
        "[6] or [B,6], with heading [9] or [B,9]",
        ((6, 9),),
        COORDINATE,
        unit="m, m/s, m/s^2",
        tensor="x_curr",
        batched=True,
    ),
    "x_goal": Array(
        f"Position [m], velocity {VELOCITY}.",
        "[4] or [B,4], with heading [6] or [B,6]",
        ((4, 6),),
        COORDINATE,
        unit="m, m/s",
        tensor="x_goal",
        batched=True,
    ),
}
"""A planner with a cost map requires these."""


class PlanOptions(TypedDict, total=False):
    """The further fields of a request on a map; None leaves a field to the card."""

    w_style: Annotated[
        str | ArrayLike | None,
        Array(
            "Weights of safety, energy and smoothness, made to sum to 1; or a name: "
            + "; ".join(f"{name} is {[*weights]}" for name, weights in STYLES.items())
            + ".",
            "[3] or [B,3]",
            ((NUM_STYLE, NUM_STYLE),),
            STYLE_WEIGHT,
            tensor="w_style",
            batched=True,
            default=DEFAULT_STYLE,
            words=(*STYLES,),
        ),
    ]
    outputs: Annotated[
        Sequence[str] | None, Names("Extras of the card to send along; none by default.")
    ]
    num_samples: Annotated[
        int | None,
        Number(
            "N, anchors a scene; if the sampler chooses the best N, at most its size.",
            NUM_SAMPLES,
            default=DEFAULT_NUM_SAMPLES,
            whole=True,
        ),
    ]
    robot_radius: Annotated[
        float | None, Number("Radius of the robot; by default the card's.", ROBOT_RADIUS)
    ]
    footprint: Annotated[ArrayLike | None, FOOTPRINT]
    kinematics: Annotated[
        Kinematics | Mapping[str, Any] | None,
        KINEMATICS,
    ]
    v_max: Annotated[float | None, Number("Limit of speed; by default the card's.", V_MAX)]
    a_max: Annotated[float | None, Number("Limit of acceleration; by default the card's.", A_MAX)]
    horizon_s: Annotated[
        float | None,
        Number(
            "Time that every anchor spans; by default the card's or, if it has none, each "
            "anchor's own.",
            HORIZON,
        ),
    ]
    cost_penalty: Annotated[
        float | None,
        Number(
            "Metres of detour that one metre through soft cost 1 is worth; 0: soft costs do not "
            "count.",
            COST_PENALTY,
            default=DEFAULT_COST_PENALTY,
        ),
    ]
    clear_start: Annotated[
        bool | None, Flag("Free the cells under the robot at the start.", default=False)
    ]
    goal_tolerance: Annotated[
        GoalTolerance | Mapping[str, Any] | None,
        GOAL_TOLERANCE,
    ]
    obstacles: Annotated[
        Obstacles | Mapping[str, Any] | None,
        OBSTACLES,
    ]
    model: Annotated[
        str | None,
        Text(
            f"Name of a model; by default, and by the name {DEFAULT_MODEL!r}, the service's first."
        ),
    ]
    seed: Annotated[
        int | None,
        Number("Seed of the noise; drawn by default, and echoed.", SEED, whole=True),
    ]
    warm_start: Annotated[
        WarmStart | Mapping[str, Any] | None,
        WARM_START,
    ]
    sampler: Annotated[
        SamplerChoice | Mapping[str, Any] | None,
        SAMPLER,
    ]
    refine: Annotated[
        RefineChoice | Mapping[str, Any] | None,
        REFINE,
    ]
    budget_ms: Annotated[
        float | None, Number("Time left to the caller, counted from arrival.", BUDGET)
    ]
    robot_id: Annotated[
        str | None,
        Text(
            "Who asks: a newer request of the same robot supersedes one that still waits or is "
            "planned."
        ),
    ]


class RequestOptions(PlanOptions, total=False):
    """The further fields of any request."""

    inputs: Annotated[
        Mapping[str, Any] | None,
        Inputs("For planners without a cost map: what their card lists, by name."),
    ]
    delay_s: Annotated[
        float | None,
        Number(
            "Of a car whose card's finish is of kind guard: time from its sensor data until it "
            "follows the plan, which begins where it will be by then.",
            DELAY,
            default=0.0,
        ),
    ]
    last_plan: Annotated[
        ArrayLike | None,
        TimedPoses(
            "What the car does until delay_s: time [s] from its sensor data, x, y [m], heading "
            "[rad]; by default it keeps its speed and yaw rate.",
            "[K,4]",
            ((2, MAX_LAST_PLAN_STEPS), (4, 4)),
            COORDINATE,
            unit="s, m, m, rad",
            tensor="last_plan",
        ),
    ]
    request_id: Annotated[str | None, Text("Echoed; by default the X-Request-Id header, or drawn.")]


OPTIONS = rows_of(RequestOptions)
REQUEST = Group("A request, checked.", MAP_FIELDS | OPTIONS)
LIMITS: dict[str, Interval] = {
    "robot_radius": ROBOT_RADIUS,
    "v_max": V_MAX,
    "a_max": A_MAX,
    "horizon_s": HORIZON,
}
"""The limits that a request may state, within the ranges of the card."""
BODY_OPTIONS = ("footprint", "kinematics")
"""The options that ask for poses: x, y and heading."""
MAP_OPTIONS = (
    *LIMITS,
    *BODY_OPTIONS,
    "cost_penalty",
    "clear_start",
    "goal_tolerance",
    "obstacles",
)
"""The options of a request on a map alone, beside those that `AnchorRequest.build` checks."""
