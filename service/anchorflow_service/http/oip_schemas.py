"""The Open Inference Protocol as documentation: what /openapi.json shows of `/v2/…`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from anchorflow_client.contract.checks import MAX_AXES, MAX_TEXT_LENGTH
from anchorflow_service.http.infer_codec import MAX_ENTRIES

Text = Annotated[str, Field(min_length=1, max_length=MAX_TEXT_LENGTH, pattern=r"^[ -~]*$")]
Shape = Annotated[list[Annotated[int, Field(ge=1)]], Field(max_length=MAX_AXES)]
Datatype = Literal["FP32", "FP64", "INT64", "UINT8", "BOOL", "BYTES"]
Scalar = bool | int | float | str
Numbers = list[float] | list[list[float]] | list[list[list[float]]] | list[list[list[list[float]]]]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid")


class MetadataTensorBody(BaseModel):
    """A tensor that a model takes or gives."""

    name: str
    datatype: Datatype
    shape: list[int] = Field(description="-1 for an axis of any length.")


class ModelMetadataBody(BaseModel):
    """What a model takes and gives for a batch of scenes; without its first axis for one scene."""

    name: str
    versions: list[str]
    platform: str
    inputs: list[MetadataTensorBody]
    outputs: list[MetadataTensorBody]


class ModelReadyBody(BaseModel):
    """Whether a model takes requests now."""

    name: str
    ready: bool


class InferInputBody(_Body):
    """A tensor in JSON; in the binary form its data stand behind the header."""

    name: Text = Field(description="Of the model's metadata.")
    datatype: Datatype
    shape: Shape
    data: Numbers | list[bool] | list[str] = Field(
        description="In row-major order; numbers, or for BOOL booleans, flat or nested."
    )


class OutputParametersBody(_Body):
    """How an output is wanted."""

    binary_data: bool = False


class InferOutputBody(_Body):
    """An output that is wanted."""

    name: Text = Field(description="Of the model's metadata.")
    parameters: OutputParametersBody | None = None


EXAMPLE = {
    "inputs": [
        {"name": "cost_map", "datatype": "FP32", "shape": [1, 16, 16], "data": [0.0] * 256},
        {"name": "map_geometry", "datatype": "FP32", "shape": [3], "data": [-4.0, -4.0, 0.5]},
        {
            "name": "x_curr",
            "datatype": "FP64",
            "shape": [6],
            "data": [-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        },
        {"name": "x_goal", "datatype": "FP64", "shape": [4], "data": [3.0, 1.0, 0.0, 0.0]},
    ],
    "parameters": {"num_samples": 4},
}
"""The same as that of `POST /anchors`."""


class InferRequestBody(_Body):
    """Arrays are tensors, all other fields of a request parameters by their JSON path."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [EXAMPLE]})

    id: Text | None = Field(None, description="Echoed.")
    parameters: dict[str, Scalar] | None = Field(
        None,
        max_length=MAX_ENTRIES,
        description="num_samples, seed, budget_ms, robot_id, sampler.method, refine.project, …; "
        "`binary_data_output` for outputs in binary, `timeout` for a budget in microseconds.",
    )
    inputs: list[InferInputBody] = Field(
        max_length=MAX_ENTRIES,
        description="map_geometry is [3] or [B,3]: origin x and y [m], resolution [m/cell].",
    )
    outputs: list[InferOutputBody] | None = Field(
        None, max_length=MAX_ENTRIES, description="All of them."
    )


class AnswerTensorBody(BaseModel):
    """An output; its data stand behind the header where it was wanted in binary."""

    name: str
    datatype: str
    shape: list[int]
    data: list[Any] | None = None
    parameters: dict[str, Any] | None = None


class InferAnswerBody(BaseModel):
    """The outputs that were asked for."""

    model_name: str
    model_version: str
    id: str
    parameters: dict[str, Scalar] = Field(description="dt, seed, timing_ms.…, model.sha256.")
    outputs: list[AnswerTensorBody]


class IndexRequestBody(_Body):
    """Which models are listed."""

    ready: bool = Field(False, description="Only those that are served.")


class ModelStateBody(BaseModel):
    """What is known of one version of a model."""

    name: str
    version: str = Field(
        description="Where the manifest cannot be read, the name of its folder among versions, "
        "or empty."
    )
    state: Literal["READY", "UNAVAILABLE"]
    reason: str = Field(description="Why it is not served, or why its newer bundle is not.")


class LoadParametersBody(_Body):
    """What is loaded."""

    version: Text | None = Field(None, description="The newest.")


class LoadRequestBody(_Body):
    """How a model is loaded."""

    parameters: LoadParametersBody | None = None


class UnloadParametersBody(_Body):
    """What Triton's clients send."""

    unload_dependents: bool = Field(False, description="No model depends on another.")


class UnloadRequestBody(_Body):
    """How a model is unloaded."""

    parameters: UnloadParametersBody | None = None
