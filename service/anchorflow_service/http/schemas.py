"""What /openapi.json shows of answers; `openapi.py` has the schemas of requests."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from anchorflow_client.oip_message import DATATYPES

Vector = list[float]
Matrix = list[list[float]]
Tensor3 = list[list[list[float]]]
Tensor4 = list[list[list[list[float]]]]
Datatype = Annotated[str, Field(json_schema_extra={"enum": [*DATATYPES]})]
Scalar = bool | int | float | str


def _array(shape: str, unit: str, meaning: str, *default: None) -> Any:
    """A field of an answer that is an array; with a default it may be absent."""
    facts: dict[str, Any] = {"x-shape": shape} | ({"x-unit": unit} if unit else {})
    return Field(default[0] if default else ..., description=meaning, json_schema_extra=facts)


class ModelIdBody(BaseModel):
    """Which weights answered."""

    name: str
    version: str
    sha256: str = Field(description="Of the bundle's manifest.")


class TimingBody(BaseModel):
    """Durations of the stages in ms."""

    model_config = ConfigDict(extra="allow")

    queue: float = Field(description="Waiting for a worker.")
    encode: float | None = Field(None, description="Encoding the scenes.")
    sample: float | None = Field(None, description="Integrating the flow.")
    refine: float | None = Field(None, description="Smoothing, projecting, scoring.")
    total: float = Field(description="From arrival to the answer, its writing excluded.")


class AnchorAnswerBody(BaseModel):
    """N anchors a scene; a B axis leads every array if the request was batched.

    The extras that `outputs` named are further fields.
    """

    model_config = ConfigDict(extra="allow")

    trajectories: Tensor3 | Tensor4 = _array(
        "[N,T,D]", "m", "The third of D = 3 is a heading [rad]."
    )
    velocities: Tensor3 | Tensor4 | None = _array(
        "[N,T,D]", "m/s", "This and the next five if the model's card lists them.", None
    )
    accelerations: Tensor3 | Tensor4 | None = _array("[N,T,D]", "m/s^2", "", None)
    scores: Vector | Matrix | None = _array("[N]", "", "Higher is better.", None)
    clearance: Vector | Matrix | None = _array(
        "[N]",
        "m",
        "Smallest along the path: beyond robot_radius to an obstacle, or from the path to the "
        "edge of the map.",
        None,
    )
    safe: list[bool] | list[list[bool]] | None = _array(
        "[N]",
        "",
        "Whether the path keeps robot_radius and certified_margin from every obstacle, "
        "certified_margin from the edge of the map, and v_max and a_max. Of a car, with "
        "refine.guard: whether it can be driven, stays on the perceived road and meets nobody.",
        None,
    )
    routes: list[int] | list[list[int]] | None = _array(
        "[N]",
        "",
        "The way that each anchor takes: those with the same number pass every obstacle, still or "
        "moving, on the same side.",
        None,
    )
    dt: float | Vector | Matrix = _array(
        "[N]", "s", "Between two time steps; one number if all anchors are alike."
    )
    first_s: float = Field(
        description="From now to the first time step.", json_schema_extra={"x-unit": "s"}
    )
    seed: int = Field(description="Give it again for the same anchors.")
    model: ModelIdBody
    timing_ms: TimingBody
    request_id: str
    reason: str | None = Field(
        None,
        description="Why no anchor is safe, in one sentence; null if one is. In a batch, that of "
        "each scene without a safe anchor, by its number.",
    )
    absent_inputs: str | None = Field(
        None,
        description="Optional inputs of the card that the request left out, separated by commas.",
    )


class ErrorDetail(BaseModel):
    """The reason for an error."""

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
        default=None, ge=0, description="s until a retry may succeed; with overloaded, if known."
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


class MetadataTensorBody(BaseModel):
    """An input or output of a model."""

    name: str
    datatype: Datatype
    shape: list[int] = Field(description="-1 for an axis of any length.")


class ModelMetadataBody(BaseModel):
    """The tensors of a model for a batch of scenes; for one scene without the first axis."""

    name: str
    versions: list[str]
    platform: str
    inputs: list[MetadataTensorBody]
    outputs: list[MetadataTensorBody]


class ModelReadyBody(BaseModel):
    """Readiness of a model."""

    name: str
    ready: bool


class AnswerTensorBody(BaseModel):
    """An output; in binary its data follow the header."""

    name: str
    datatype: str
    shape: list[int]
    data: list[Any] | None = None
    parameters: dict[str, Any] | None = None


class InferAnswerBody(BaseModel):
    """The outputs of a request."""

    model_name: str
    model_version: str
    id: str
    parameters: dict[str, Scalar] = Field(description="dt, seed, timing_ms.…, model.sha256.")
    outputs: list[AnswerTensorBody]


class ModelStateBody(BaseModel):
    """The state of one version of a model."""

    name: str
    version: str = Field(
        description="Where the manifest cannot be read, the name of its folder among versions, "
        "or empty."
    )
    state: Literal["READY", "UNAVAILABLE"]
    reason: str = Field(description="Why it is not served, or why its newer bundle is not.")
