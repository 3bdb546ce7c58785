"""The model card: what a bundle is, what it takes and gives, and how well it does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from anchorflow_client.contract.sampling import RefineSpec, SamplerSpec


@dataclass(frozen=True)
class ModelId:
    """Which weights answered."""

    name: str
    version: str
    sha256: str


@dataclass(frozen=True)
class TensorSpec:
    """A tensor by name, type and axes."""

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    """Axis letters (B, N, T, D, C, H, W) or fixed sizes."""
    unit: str = ""
    range: tuple[float | None, float | None] | None = None
    """Least and greatest value; None is unbounded."""

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> TensorSpec:
        """Read `asdict` back, lists in place of tuples included."""
        limits = value.get("range")
        return cls(
            name=value["name"],
            dtype=value["dtype"],
            shape=tuple(value["shape"]),
            unit=value.get("unit", ""),
            range=None if limits is None else tuple(limits),
        )


@dataclass(frozen=True)
class MapSpec:
    """The grid that a model was trained on, to which the service brings the caller's."""

    H: int
    W: int
    channels: int


@dataclass(frozen=True)
class ModelCard:
    """All that a caller may want to know of a bundle before asking it."""

    name: str
    version: str
    sha256: str
    """Of the manifest's bytes."""
    planner: str
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    T: int
    """Time steps of an anchor."""
    D: int
    """Dimensions of a position: 2 (x, y), or 3 (x, y, heading in rad)."""
    horizon_s: float
    dt: float
    """s between two time steps: horizon_s / (T - 1)."""
    v_max: float
    """m/s in the plane; answers keep it."""
    a_max: float
    """m/s^2 in the plane; answers keep it."""
    robot_radius: float
    """m."""
    map: MapSpec
    sampler: SamplerSpec
    refine: RefineSpec
    adjustable: tuple[str, ...] = ()
    """Which of robot_radius, v_max, a_max and horizon_s a request may change."""
    quality: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)

    @property
    def id(self) -> ModelId:
        """Name, version and hash, as every answer carries them."""
        return ModelId(self.name, self.version, self.sha256)

    def to_dict(self) -> dict[str, Any]:
        """Plain types that any JSON writer takes."""
        return asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> ModelCard:
        """Read `to_dict` back; keys that this version does not know are left out.

        Raises:
            KeyError, TypeError: a key is missing, or holds something else than the card's.
        """
        known = {item.name: value[item.name] for item in fields(cls) if item.name in value}
        sampler = value["sampler"]
        return cls(
            **known
            | {
                "inputs": tuple(map(TensorSpec.from_dict, value["inputs"])),
                "outputs": tuple(map(TensorSpec.from_dict, value["outputs"])),
                "map": MapSpec(**value["map"]),
                "sampler": SamplerSpec(sampler["method"], tuple(sampler["schedule"])),
                "refine": RefineSpec(**value["refine"]),
                "adjustable": tuple(value.get("adjustable", ())),
            }
        )
