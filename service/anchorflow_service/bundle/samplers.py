"""How a bundle's anchors are drawn, as its manifest says it, by kind."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    Field,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    model_validator,
)

from anchorflow_client.contract import OdeSpec, TruncatedDiffusionSpec, VocabularySpec
from anchorflow_service.bundle.conditioning import Entry
from anchorflow_trajectory.ode.ddim import NoiseLevels
from anchorflow_trajectory.ode.methods import method_named
from anchorflow_trajectory.ode.schedule import check_schedule


class PriorEntry(Entry):
    """What turns noise [N,R] into x_0 = mean + noise · basis."""

    mean: str
    """Name of [B,T,S] that encode gives; or of [B,M,T,S] that encode gives or a scene has, the M
    components of a mixture over which the anchors are dealt out in turn."""
    basis: str
    """Name of [B,R,T*S] that encode gives."""


class OdeEntry(Entry):
    """A flow, carried from noise by an explicit method; the card's defaults."""

    kind: Literal["ode"] = "ode"
    method: Annotated[str, AfterValidator(lambda name: method_named(name).name)]
    """`euler`, `midpoint`, `rk4`, …."""
    schedule: Annotated[tuple[float, ...], AfterValidator(check_schedule)]
    """Flow times, rising from 0 to 1."""
    prior: PriorEntry | None = None
    """Null where a flow begins with the noise itself, [N,T,S]."""

    def spec(self) -> OdeSpec:
        """What the card says of it."""
        return OdeSpec(self.method, self.schedule)


class VocabularyEntry(Entry):
    """The best N of `size` trajectories, which the graphs give and may have refined."""

    kind: Literal["vocabulary"] = "vocabulary"
    size: PositiveInt
    """Anchors a request, at most."""

    def spec(self) -> VocabularySpec:
        """What the card says of it."""
        return VocabularySpec(self.size)


class NoiseLevelsEntry(Entry):
    """Variances of a whole diffusion, whose square roots rise evenly (`NoiseLevels`)."""

    levels: PositiveInt
    first: PositiveFloat
    """beta of the first level."""
    last: PositiveFloat
    """beta of the last, below 1."""

    @model_validator(mode="after")
    def _rise(self) -> NoiseLevelsEntry:
        self.variances()
        return self

    def variances(self) -> NoiseLevels:
        """Raises `ValueError` where they are none."""
        return NoiseLevels(self.levels, self.first, self.last)


class TruncatedDiffusionEntry(Entry):
    """A diffusion that begins at anchors with a little noise; then the best, coarse to fine."""

    kind: Literal["truncated_diffusion"] = "truncated_diffusion"
    anchors: PositiveInt
    """Of the graphs."""
    groups: PositiveInt
    """Noises that each anchor begins with."""
    variants: PositiveInt
    """Of each denoised trajectory, the first without noise of its own."""
    vocabulary: NonNegativeInt = 0
    """Trajectories that the coarse graph adds to them."""
    keep: PositiveInt
    """The best by coarse scores, which are scored finely."""
    noise: NoiseLevelsEntry
    start: NonNegativeInt
    """The level at which anchors begin."""
    schedules: Annotated[tuple[tuple[int, ...], ...], Field(min_length=1)]
    """The levels at which each number of steps denoises."""
    steps: PositiveInt
    """Of a request that names no number."""

    @model_validator(mode="after")
    def _fits(self) -> TruncatedDiffusionEntry:
        levels = self.noise.variances()
        try:
            for schedule in self.schedules:
                levels.check_times(schedule)
        except ValueError as error:
            raise ValueError(f"schedules: {error}") from error
        if self.start >= levels.levels:
            raise ValueError(f"start: expected a level below {levels.levels}, got {self.start}")
        if self.steps not in self.choices or len(set(self.choices)) < len(self.choices):
            known = ", ".join(map(str, self.choices))
            raise ValueError(f"steps: expected one of {known}, each once, got {self.steps}")
        if self.keep > self.candidates:
            raise ValueError(f"keep: expected at most {self.candidates}, got {self.keep}")
        return self

    @property
    def candidates(self) -> int:
        """All that are scored coarsely."""
        return self.anchors * self.groups * self.variants + self.vocabulary

    @property
    def choices(self) -> tuple[int, ...]:
        """The numbers of steps that there are schedules for."""
        return tuple(len(schedule) for schedule in self.schedules)

    def levels_of(self, steps: int) -> tuple[int, ...]:
        """Where so many steps denoise."""
        return self.schedules[self.choices.index(steps)]

    def spec(self) -> TruncatedDiffusionSpec:
        """What the card says of it."""
        return TruncatedDiffusionSpec(self.keep, self.candidates, self.steps, self.choices)
