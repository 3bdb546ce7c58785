"""The JSON contract as documentation: what /openapi.json shows, with units and ranges.

Requests are not checked here: a map of 512 x 512 cells is checked by numpy, and every other field
beside it by the contract itself, so that each transport refuses in the same words. The ranges are
the contract's own.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from anchorflow_client.contract import DEFAULT_STYLE, STYLES, ranges
from anchorflow_client.contract.ranges import Interval

# What is answered.
Vector = list[float]
Matrix = list[list[float]]
Tensor3 = list[list[list[float]]]
Tensor4 = list[list[list[list[float]]]]


# What is asked, as far as a schema tells. Beyond it is checked that a map has enough cells in rows
# of one length, that B and D are the same everywhere, that velocities and accelerations keep to
# their ranges, and that start and goal lie on free cells.
_SIDE = Field(min_length=1, max_length=ranges.MAX_MAP_CELLS)
_BATCH = Field(min_length=1, max_length=ranges.MAX_SCENES)
Text = Annotated[str, Field(min_length=1, max_length=ranges.MAX_TEXT_LENGTH, pattern=r"^[ -~]*$")]
Shape = Annotated[list[Annotated[int, Field(ge=1)]], Field(max_length=ranges.MAX_AXES)]
Share = Annotated[float, Field(ge=0, le=1)]
Grid = Annotated[
    list[Annotated[list[Annotated[list[Share], _SIDE]], _SIDE]],
    Field(min_length=1, max_length=ranges.MAX_CHANNELS),
]
Coordinate = Annotated[float, Field(ge=ranges.COORDINATE.low, le=ranges.COORDINATE.high)]
Origin = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
State = Annotated[list[Coordinate], Field(min_length=6, max_length=9)]
Goal = Annotated[list[Coordinate], Field(min_length=4, max_length=6)]
Weight = Annotated[float, Field(ge=ranges.STYLE_WEIGHT.low, le=ranges.STYLE_WEIGHT.high)]
Style = Annotated[list[Weight], Field(min_length=3, max_length=3)]
StyleName = Annotated[str, Field(json_schema_extra={"enum": [*STYLES]})]
Schedule = Annotated[list[Share], Field(min_length=2, max_length=ranges.MAX_SCHEDULE_STEPS + 1)]
Trajectory = Annotated[
    list[Annotated[list[Coordinate], Field(min_length=2, max_length=9)]],
    Field(min_length=2, max_length=ranges.MAX_WARM_START_STEPS),
]

Method = Annotated[str, Field(json_schema_extra={"enum": [*ranges.METHODS]})]


def _within(interval: Interval, description: str, **options: Any) -> Any:
    """A field with the contract's range."""
    low = "gt" if interval.open_low else "ge"
    high = "lt" if interval.open_high else "le"
    bounds: dict[str, Any] = {low: interval.low, high: interval.high}
    unit = f" [{interval.unit}]" if interval.unit else ""
    return Field(description=f"{description}{unit}.", **bounds, **options)


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid")


class CostMapBody(_Body):
    """What the robot knows of the space around it; row grows with y, column with x."""

    data: Grid | Annotated[list[Grid], _BATCH] = Field(
        description="[C,H,W] or [B,C,H,W] in [0, 1]; C from 1 to 8, H and W from 16 to 512. "
        "Channel 0 is obstacle occupancy (0.5 and above), 1 traversability, 2 risk."
    )
    resolution: float = _within(ranges.RESOLUTION, "Size of a cell")
    origin: Origin | None = Field(
        None, description="[2] m, outer corner of cell (0, 0); by default the map is centred on 0."
    )


class UniformSchedule(_Body):
    """Steps of equal length."""

    uniform: int = Field(ge=1, le=ranges.MAX_SCHEDULE_STEPS, description="Number of steps.")


class SamplerBody(_Body):
    """The solver of the flow; what is left out is the card's."""

    method: Method | None = Field(None, description="Method of integration.")
    schedule: Literal["8step"] | UniformSchedule | Schedule | None = Field(
        None, description="Flow times from 0 (noise) to 1 (data), at least 1e-6 apart."
    )


class RefineBody(_Body):
    """What is done to the samples; what is left out is the card's."""

    smooth: bool | None = Field(None, description="Fit the spline with fixed ends.")
    project: bool | None = Field(None, description="Push anchors out of obstacles.")
    safety_margin: float | None = _within(
        ranges.SAFETY_MARGIN, "Distance beyond robot_radius to aim at", default=None
    )
    guidance: float | None = _within(
        ranges.GUIDANCE, "Scale of the cost gradient inside the flow", default=None
    )
    barrier: bool | None = Field(
        None, description="Correct anchors that are still too near by a control barrier."
    )
    certified_margin: float | None = _within(
        ranges.CERTIFIED_MARGIN,
        "Distance beyond robot_radius that every anchor called safe keeps",
        default=None,
    )


class WarmStartBody(_Body):
    """A trajectory to start from in place of noise."""

    trajectory: Trajectory = Field(
        description="[T,D], [T,2D] or [T,3D]: p [m], v [m/s], a [m/s^2]; D is the model's, 2 or 3."
    )
    tau: float | None = _within(
        ranges.INSIDE_UNIT, "Flow time to start at", default=ranges.DEFAULT_TAU
    )
    dt: float | None = _within(
        ranges.TIME_STEP,
        "Time between two of its samples; by default it lasts as long as horizon_s or, where there "
        "is none, as long as the model thinks that its way takes",
        default=None,
    )


class ArrayBody(_Body):
    """A tensor as the bytes that it is, little-endian, in row-major order."""

    dtype: Literal["bool", "uint8", "int64", "float32", "float64"]
    shape: Shape
    base64: str


class PngBody(_Body):
    """A picture, decoded to uint8 [3,H,W]."""

    png: str = Field(description="base64")


class JpegBody(_Body):
    """A picture, decoded to uint8 [3,H,W]."""

    jpeg: str = Field(description="base64")


InputBody = ArrayBody | PngBody | JpegBody | str | float | list[Any]
"""An array, a picture, a text or nested lists of numbers; a list of strings is a batch."""

EXAMPLE = {
    "cost_map": {"data": [[[0.0] * 16] * 16], "resolution": 0.5},
    "x_curr": [-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "x_goal": [3.0, 1.0, 0.0, 0.0],
    "num_samples": 4,
}
"""A free map of 8 m around (0, 0), crossed from left to right."""


class AnchorRequestBody(_Body):
    """A map, a state and a goal in the map's frame, or the inputs that the model's card lists;
    everything else has a default. SI units.

    A leading B on cost_map.data, x_curr, x_goal or w_style makes it a batch of scenes; a field
    without it is shared by all of them.
    """

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [EXAMPLE]})

    cost_map: CostMapBody | None = Field(None, description="Of planners with a cost map, required.")
    x_curr: State | Annotated[list[State], _BATCH] | None = Field(
        None,
        description=f"[6] or [B,6]: p [m], v {ranges.VELOCITY}, a {ranges.ACCELERATION}, each x "
        "and y; [9] or [B,9] for a model with D = 3: x, y and heading [rad], which runs on beyond "
        "pi; map and limits see x and y alone.",
    )
    x_goal: Goal | Annotated[list[Goal], _BATCH] | None = Field(
        None,
        description=f"[4] or [B,4]: p [m], v {ranges.VELOCITY}; [6] or [B,6] with heading.",
    )
    w_style: Style | Annotated[list[Style], _BATCH] | StyleName | None = Field(
        list(DEFAULT_STYLE),
        description="[3] or [B,3] at least 0: safety, energy, smooth; made to sum to 1; or a name: "
        + "; ".join(f"{name} is {[*weights]}" for name, weights in STYLES.items())
        + ".",
    )
    inputs: dict[Text, InputBody] | None = Field(
        None,
        description="Of planners without a cost map: what their card lists, by name.",
    )
    outputs: list[Text] | None = Field(
        None, description="Extras of the card that are sent along; none by default."
    )
    num_samples: int | None = _within(
        ranges.NUM_SAMPLES,
        "N, anchors a scene; of a sampler that chooses the best N, at most its size",
        default=ranges.DEFAULT_NUM_SAMPLES,
    )
    robot_radius: float | None = _within(
        ranges.ROBOT_RADIUS, "Radius of the robot; by default the card's", default=None
    )
    v_max: float | None = _within(
        ranges.V_MAX, "Limit of speed; by default the card's", default=None
    )
    a_max: float | None = _within(
        ranges.A_MAX, "Limit of acceleration; by default the card's", default=None
    )
    horizon_s: float | None = _within(
        ranges.HORIZON,
        "Time that every anchor spans; by default the card's or, where that has none, each "
        "anchor's own",
        default=None,
    )
    model: Text | None = Field(None, description="Name of a model; without it the default one.")
    seed: int | None = _within(
        ranges.SEED, "Of the noise; drawn by default, and echoed", default=None
    )
    sampler: SamplerBody | None = Field(None, description="The card's.")
    refine: RefineBody | None = Field(None, description="The card's.")
    warm_start: WarmStartBody | None = Field(None, description="None: start from noise.")
    budget_ms: float | None = _within(
        ranges.BUDGET, "Time left to the caller, from arrival", default=None
    )
    robot_id: Text | None = Field(
        None,
        description="Who asks: a newer request of the same robot supersedes one that still waits "
        "or is planned.",
    )
    request_id: Text | None = Field(
        None, description="Echoed; by default the X-Request-Id header, or drawn."
    )


class ModelIdBody(BaseModel):
    """Which weights answered."""

    name: str
    version: str
    sha256: str = Field(description="Of the bundle's manifest.")


class TimingBody(BaseModel):
    """Where the time went, in ms."""

    model_config = ConfigDict(extra="allow")

    queue: float = Field(description="Waiting for a worker.")
    encode: float | None = Field(None, description="Encoding the scenes.")
    sample: float | None = Field(None, description="Integrating the flow.")
    refine: float | None = Field(None, description="Smoothing, projecting, scoring.")
    total: float = Field(description="From arrival to the answer, its writing excluded.")


class AnchorAnswerBody(BaseModel):
    """N anchors a scene; a B axis leads every array where the request was batched.

    The extras that `outputs` named stand beside these by their own names.
    """

    model_config = ConfigDict(extra="allow")

    trajectories: Tensor3 | Tensor4 = Field(
        description="[N,T,D] m; the third of D = 3 is a heading [rad]."
    )
    velocities: Tensor3 | Tensor4 | None = Field(
        None, description="[N,T,D] m/s; this and the next four where the model's card lists them."
    )
    accelerations: Tensor3 | Tensor4 | None = Field(None, description="[N,T,D] m/s^2.")
    scores: Vector | Matrix | None = Field(None, description="[N], higher is better.")
    clearance: Vector | Matrix | None = Field(
        None,
        description="[N] m, smallest along the path: beyond robot_radius to an obstacle, or from "
        "the path to the edge of the map.",
    )
    safe: list[bool] | list[list[bool]] | None = Field(
        None,
        description="[N], whether the path keeps robot_radius and certified_margin from every "
        "obstacle, certified_margin from the edge of the map, and v_max and a_max.",
    )
    dt: float | Vector | Matrix = Field(
        description="[N] s between two time steps, or one number where all anchors are alike."
    )
    first_s: float = Field(description="s from now to the first time step.")
    seed: int = Field(description="Give it again for the same anchors.")
    model: ModelIdBody
    timing_ms: TimingBody
    request_id: str
    absent_inputs: str | None = Field(
        None,
        description="Optional inputs of the card that the request did not bring, separated by "
        "commas.",
    )


class ErrorDetail(BaseModel):
    """What was refused, and why."""

    code: Literal[
        "invalid_request",
        "unknown_model",
        "too_large",
        "unauthorized",
        "overloaded",
        "superseded",
        "deadline_exceeded",
        "not_ready",
        "internal",
    ]
    message: str = Field(description="What was expected and what came.")
    field: str | None = Field(description="JSON path of the culprit.")
    retry_after_s: float | None = Field(
        default=None, ge=0, description="s; of overloaded, where it is known: when to ask again."
    )


class ErrorBody(BaseModel):
    """Every answer that is not 200."""

    error: ErrorDetail


class ModelCardBody(BaseModel):
    """A model's card."""

    model_config = ConfigDict(extra="allow")

    name: str
    version: str
    ready: bool


class ModelsBody(BaseModel):
    """The cards of all models."""

    models: list[ModelCardBody]
