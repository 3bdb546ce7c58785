"""Networks so small that they are traced in seconds, and bundles of them that are exported once.

`SmallFlow` has every kind of operation that traces badly: a convolution, attention, a map lookup.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch
from exported_bundles import Exported, export_once
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_client.contract import (
    CostMapSpec,
    LimitsSpec,
    OdeSpec,
)
from anchorflow_export.adapter import PlannerAdapter
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.planners.flowmp import flow_adapter
from anchorflow_service.bundle.manifest import SplineEntry

T, D, S, R, WIDTH = 8, 2, 7, 5, 16


class SmallFlow(nn.Module):
    """The interface of the planners, with every kind of operation that traces badly."""

    basis: Tensor
    context_for_modulate: ClassVar = ("condition",)
    context_for_field: ClassVar = ("features", "map_geometry_seen")

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, 4, 3, stride=2, padding=1)
        self.condition = nn.Linear(6 + 4 + 3 + 4 + 4, WIDTH)
        self.modulation = nn.Linear(WIDTH + 1, 2 * WIDTH)
        self.project_in = nn.Linear(2 * S + 4, WIDTH)
        self.head = nn.Linear(WIDTH, S)
        self.register_buffer("basis", 0.1 * torch.randn(R, T * S))

    def encode(
        self,
        cost_map: Tensor,
        map_geometry: Tensor,
        clearance_field: Tensor,
        x_curr: Tensor,
        x_goal: Tensor,
        w_style: Tensor,
        limits: Tensor,
    ) -> dict[str, Tensor]:
        maps = torch.cat([cost_map[:, :2], clearance_field[:, None]], 1)
        features = F.interpolate(self.conv(maps), size=(12, 12), mode="bilinear")
        parts = [x_curr - x_curr.mean(-1, keepdim=True), x_goal[:, 2:], w_style]
        parts += [limits, features.mean((2, 3)), map_geometry[:, 2:] * 0, x_goal[:, :1] * 0]
        return {
            "prior_basis": self.basis.expand(cost_map.shape[0], -1, -1),
            "condition": self.condition(torch.cat(parts, -1)),
            "features": features,
            "map_geometry_seen": map_geometry,
            "unused": w_style,
        }

    def modulate(self, times: Tensor, context: dict[str, Tensor]) -> Tensor:
        condition = context["condition"][:, None].expand(-1, times.shape[0], -1)
        at = times[None, :, None].expand(condition.shape[0], -1, -1)
        return self.modulation(torch.cat([condition, at], -1))

    def field(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: dict[str, Tensor]
    ) -> Tensor:
        batch, count = x_t.shape[:2]
        geometry = context["map_geometry_seen"][:, None, None]
        points = ((x_t[..., :2] - geometry[..., :2]) / 10.0) * 2 - 1
        seen = F.grid_sample(
            context["features"], points, padding_mode="border", align_corners=False
        ).permute(0, 2, 3, 1)
        scale, shift = modulation[:, None, None].chunk(2, -1)
        x = self.project_in(torch.cat([0.1 * x_t, 0.1 * (x_t - prior_mean), seen], -1))
        x = F.layer_norm(x, (WIDTH,)) * (1 + scale) + shift
        heads = x.reshape(batch * count, T, 2, WIDTH // 2).transpose(1, 2)
        mixed = F.scaled_dot_product_attention(heads, heads, heads)
        return self.head(F.gelu(mixed.transpose(1, 2).reshape(batch, count, T, WIDTH)))


@pytest.fixture(scope="session")
def small_flow() -> Callable[[], SmallFlow]:
    """Makes small flows, always of the same weights."""

    def make() -> SmallFlow:
        with torch.random.fork_rng():
            torch.manual_seed(0)
            return SmallFlow()

    return make


@pytest.fixture(scope="session")
def description() -> BundleDescription:
    """The small flow's name, version and provenance."""
    return BundleDescription(
        name="small-flow", version="0.0.1", planner="stand-in", training={"checkpoint": "none"}
    )


@pytest.fixture(scope="session")
def adapted() -> Callable[..., PlannerAdapter]:
    """Adapts a flow model; what is not told is as the small flow has it."""

    def adapt(model: Any, *, H: int = 32, W: int = 32, **told: Any) -> PlannerAdapter:
        limits = LimitsSpec(horizon_s=8.0, v_max=2.0, a_max=3.0, robot_radius=0.25)
        parts: dict[str, Any] = {
            "T": T,
            "D": D,
            "conditioning": CostMapSpec(
                channels=3, H=H, W=W, limits=limits, ranges={"robot_radius": (0.0, 5.0)}
            ),
            "sampler": OdeSpec("rk4", (0.0, 0.8, 0.9, 1.0)),
            "finish": SplineEntry(
                smooth=True,
                project=False,
                safety_margin=0.05,
                guidance=0.0,
                steps=4,
                num_control_points=12,
                degree=4,
            ),
        }
        return flow_adapter(model, **(parts | told))

    return adapt


@pytest.fixture(scope="session")
def small_bundle(
    small_flow: Callable[[], SmallFlow],
    adapted: Callable[..., PlannerAdapter],
    description: BundleDescription,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """The small flow's bundle, exported once; to read, not to change."""
    out = tmp_path_factory.mktemp("exported") / "bundle"
    differences = export_bundle(adapted(small_flow()), description, out=out)
    assert max(part.error for part in differences) <= 1e-5
    kinds = {part.what.split()[0] for part in differences}
    assert kinds == {"encode", "modulate", "field", "sample"}
    return out


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Exported]:
    """Exports a planner's small network, once a session."""
    return lambda planner: export_once(planner, tmp_path_factory.getbasetemp())
