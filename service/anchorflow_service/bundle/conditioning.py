"""How a planner is asked, as its manifest says it: with a cost map and limits, or with tensors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, PositiveInt

from anchorflow_client.contract import CostMapSpec, LimitsSpec, TensorsSpec, VisionLanguageSpec
from anchorflow_client.contract.fields import LIMITS

Limit = Literal["robot_radius", "v_max", "a_max", "horizon_s"]


class Entry(BaseModel):
    """A frozen piece of the manifest; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class LimitsEntry(Entry):
    """What anchors keep where a request says nothing."""

    horizon_s: PositiveFloat | None
    """s, above 0; null where each anchor has its own duration."""
    v_max: PositiveFloat
    """m/s."""
    a_max: PositiveFloat
    """m/s²."""
    robot_radius: NonNegativeFloat
    """m."""


class CostMapEntry(Entry):
    """Asked with a cost map, a state, a goal and a style."""

    kind: Literal["cost_map"] = "cost_map"
    channels: PositiveInt
    """Of the map, at most."""
    H: PositiveInt
    """Rows of the grid that the model was trained on."""
    W: PositiveInt
    """Its columns."""
    limits: LimitsEntry
    ranges: dict[Limit, tuple[float, float]] = {}
    """The limits that a request may set, and between what."""

    def spec(self) -> CostMapSpec:
        """What the card says of it."""
        limits = LimitsSpec(**self.limits.model_dump())
        return CostMapSpec(self.channels, self.H, self.W, limits, {**self.ranges})

    def faults(self) -> Iterator[str]:
        """Ranges that no request could use, or that leave out the bundle's own limit."""
        for name, (low, high) in self.ranges.items():
            where, wide = f"conditioning.ranges.{name}", LIMITS[name]
            own = getattr(self.limits, name)
            if not wide.low <= low <= high <= wide.high:
                yield f"{where} is [{low:g}, {high:g}], expected least and greatest {wide}"
            elif own is not None and not low <= own <= high:
                yield f"{where} is [{low:g}, {high:g}], without limits.{name} = {own:g}"
        if self.limits.horizon_s is None and "horizon_s" not in self.ranges:
            yield (
                "conditioning.ranges.horizon_s is missing, expected least and greatest duration "
                "of an anchor beside limits.horizon_s null"
            )


class TensorsEntry(Entry):
    """Asked with the inputs that the request lists, and nothing else."""

    kind: Literal["tensors"] = "tensors"

    def spec(self) -> TensorsSpec:
        """What the card says of it."""
        return TensorsSpec()


class VisionLanguageEntry(Entry):
    """Asked with pictures and a text, which become the pixels and tokens that the graphs take."""

    kind: Literal["vision_language"] = "vision_language"
    images: Annotated[tuple[str, ...], Field(min_length=1)]
    """The request's inputs that are pictures; of those that are optional the features are
    remembered by what they show."""
    text: str
    """Its input that is a text, written in the tokens of the bundle's file `tokenizer`."""
    image_size: PositiveInt
    """Pixels a side, to which every picture is brought."""
    max_tokens: PositiveInt
    """Of a text."""

    def spec(self) -> VisionLanguageSpec:
        """What the card says of it."""
        return VisionLanguageSpec(self.image_size, self.max_tokens)
