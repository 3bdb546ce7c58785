"""The manifest: what a bundle says of itself in manifest.json.

The reader checks it and the exporter writes it with the same classes.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    model_validator,
)

from anchorflow_client.contract import MapSpec, ModelCard, RefineSpec, SamplerSpec, TensorSpec
from anchorflow_trajectory.ode.method import method_named
from anchorflow_trajectory.ode.schedule import check_schedule

FORMAT = 1
FILE_NAME = "manifest.json"

Adjustable = Literal["robot_radius", "v_max", "a_max", "horizon_s"]
# One path segment: a bundle never reads beside its own folder.
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Part(BaseModel):
    """A frozen piece of the manifest; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class GraphEntry(Part):
    """One ONNX graph of the bundle; the key it stands under is its role.

    precision: of its products
    """

    file: FileName
    sha256: Sha256
    opset: PositiveInt
    precision: Literal["float32", "int8"] = "float32"
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(spec.name for spec in self.outputs)


class PriorEntry(Part):
    """The encode outputs that turn noise [N,R] into x_0 = mean + noise · basis.

    mean: name of [B,T,S]; basis: name of [B,R,T*S]
    """

    mean: str
    basis: str


class SamplerEntry(Part):
    """How anchors are drawn; `kind` says by which loop, the rest is the card's default."""

    kind: str
    method: Annotated[str, AfterValidator(lambda name: method_named(name).name)]
    schedule: Annotated[tuple[float, ...], AfterValidator(check_schedule)]
    prior: PriorEntry | None = None


class RefineEntry(Part):
    """How anchors are finished: the card's defaults, and the spline they are finished on."""

    smooth: bool
    project: bool
    safety_margin: NonNegativeFloat
    guidance: NonNegativeFloat
    barrier: bool = False
    certified_margin: NonNegativeFloat = 0.0
    steps: PositiveInt
    num_control_points: PositiveInt
    degree: PositiveInt


class LimitsEntry(Part):
    """horizon_s [s], v_max [m/s], a_max [m/s²] and robot_radius [m] that the model was made for."""

    horizon_s: PositiveFloat
    v_max: PositiveFloat
    a_max: PositiveFloat
    robot_radius: NonNegativeFloat


class Manifest(Part):
    """manifest.json; the axes of its tensors are letters, or numbers where the graph fixes them."""

    format: Literal[1]
    name: Annotated[str, Field(min_length=1)]
    version: Annotated[str, Field(min_length=1)]
    planner: str
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    graphs: dict[str, GraphEntry]
    sampler: SamplerEntry
    refine: RefineEntry
    T: Annotated[int, Field(ge=2)]
    D: Annotated[int, Field(ge=2, le=3)]
    dt: PositiveFloat
    limits: LimitsEntry
    adjustable: tuple[Adjustable, ...] = ()
    map: MapSpec
    training: dict[str, Any] = {}
    quality: dict[str, Any] = {}

    @model_validator(mode="after")
    def _time_step_fits_the_horizon(self) -> Manifest:
        dt = self.limits.horizon_s / (self.T - 1)
        if not math.isclose(self.dt, dt, rel_tol=1e-6):
            raise ValueError(f"dt is {self.dt}, expected horizon_s / (T - 1) = {dt}")
        return self

    @property
    def state_size(self) -> int:
        """S = 3D: position, velocity and acceleration of one time step."""
        return 3 * self.D

    def card(self, *, sha256: str) -> ModelCard:
        """What callers see of it; sha256 is that of the manifest's bytes."""
        return ModelCard(
            name=self.name,
            version=self.version,
            sha256=sha256,
            planner=self.planner,
            inputs=self.inputs,
            outputs=self.outputs,
            T=self.T,
            D=self.D,
            dt=self.dt,
            **self.limits.model_dump(),
            map=self.map,
            sampler=SamplerSpec(self.sampler.method, self.sampler.schedule),
            refine=RefineSpec(
                self.refine.smooth,
                self.refine.project,
                self.refine.safety_margin,
                self.refine.guidance,
                self.refine.barrier,
                self.refine.certified_margin,
            ),
            adjustable=self.adjustable,
            quality=self.quality,
            training=self.training,
        )

    def to_json(self) -> bytes:
        """The bytes of manifest.json."""
        return self.model_dump_json(indent=2).encode() + b"\n"


def parse_manifest(data: bytes) -> Manifest:
    """Check the bytes of manifest.json; ValueError says every field that is wrong, and how."""
    try:
        return Manifest.model_validate_json(data, strict=True)
    except ValidationError as error:
        wrong = "; ".join(_describe(item) for item in error.errors())
        raise ValueError(wrong) from error


def _describe(item: Any) -> str:
    path = ".".join(str(part) for part in item["loc"])
    return f"{path}: {item['msg']}" if path else item["msg"]
