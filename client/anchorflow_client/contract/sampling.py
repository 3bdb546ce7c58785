"""The complete settings of a sampler and a finish, as a model's card holds them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from anchorflow_client.contract.fields import RefineChoice, SamplerChoice


@dataclass(frozen=True)
class OdeSpec(SamplerChoice):
    """A complete solver of a flow: method by name, and schedule."""

    method: str = field()
    schedule: tuple[float, ...] = field()
    kind: Literal["ode"] = "ode"


@dataclass(frozen=True)
class RefineSpec(RefineChoice):
    """A complete refinement of splines."""

    smooth: bool = field()
    project: bool = field()
    safety_margin: float = field()
    guidance: float = field()
    barrier: bool = False
    certified_margin: float = 0.0
    kind: Literal["spline"] = "spline"
