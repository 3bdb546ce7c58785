"""GoalFlow behind a Transfuser backbone: where its cells lie, and what it says of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from exported_bundles import GOALFLOW, SENSING, small_goalflow
from torch import Tensor, nn

from anchorflow_models.goalflow import BevLayout, GoalFlowConfig, SensorGoalFlow
from anchorflow_models.transfuser import BevFeatures


def scenes(config: GoalFlowConfig, count: int = 2) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(1)
    sizes = dict(config.transfuser.input_sizes())
    camera = torch.randint(0, 256, (count, *sizes.pop("camera")), generator=generator)
    seen = {name: torch.rand(count, *size, generator=generator) for name, size in sizes.items()}
    status = torch.tensor([0, 1, 0, 0, 8.0, 0, 0, 0]).expand(count, -1)
    size = torch.tensor([[4.6, 1.9]]).expand(count, -1)
    return {**seen, "camera": camera.byte(), "ego_status": status, "vehicle_size": size}


class Ramp(nn.Module):
    """A backbone whose BEV holds, in two channels, where each of its cells lies: x and y in m."""

    def __init__(self, config: GoalFlowConfig) -> None:
        super().__init__()
        eyes = config.transfuser
        steps = eyes.upscaled_cell * (
            eyes.upscaled_size / 2 - 0.5 - torch.arange(eyes.upscaled_size)
        )
        self.where = torch.stack(torch.meshgrid(steps, steps, indexing="ij"))

    def forward(self, camera: Tensor, *_: Any) -> BevFeatures:
        where = self.where.expand(len(camera), -1, -1, -1)
        return BevFeatures(where, where)


@torch.no_grad()
@pytest.mark.parametrize("ground_sight", [False, True])
def test_cells_lie_where_the_raster_has_them(
    ground_sight: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Farthest ahead and left first; beyond the square the cells at its edge go on."""
    layout = BevLayout(rows=96, columns=32, extent=(-16.0, 80.0, -8.0, 8.0))
    model = small_goalflow(replace(SENSING, bev=layout, ground_sight=ground_sight))
    assert isinstance(model, SensorGoalFlow)
    given, eyes = scenes(model.config), model.config.transfuser
    monkeypatch.setattr(model, "backbone", Ramp(model.config))
    if model.ground is not None:
        monkeypatch.setattr(model.ground, "forward", lambda _camera, bev, _status: bev)
    given.pop("vehicle_size")
    cells = model.sensed(**given)[:, :2]
    edge = eyes.lidar_range - eyes.upscaled_cell / 2
    x, y = model.places.unbind(-1)
    assert (x[0, 0].item(), y[0, 0].item()) == (79.0, 7.5)
    inside = x.abs() < edge if not ground_sight else (x > eyes.ground_ahead - edge) & (x < edge)
    assert inside.any()
    torch.testing.assert_close(cells[0, 0][inside], x[inside], rtol=0, atol=1e-3)
    torch.testing.assert_close(cells[0, 1][inside], y[inside], rtol=0, atol=1e-3)
    if not ground_sight:
        assert (cells[0, 0][x > edge] == edge).all()


@torch.no_grad()
def test_scenes_of_a_batch_do_not_touch_and_surfaces_are_shares() -> None:
    model, given = small_goalflow(SENSING), scenes(SENSING)
    assert isinstance(model, SensorGoalFlow)
    both = model.encode(**given)
    for scene in range(2):
        alone = model.encode(**{name: each[scene : scene + 1] for name, each in given.items()})
        for name, tensor in alone.items():
            torch.testing.assert_close(both[name][scene : scene + 1], tensor, rtol=1e-4, atol=1e-4)
    assert both["occupied"].shape == (2, 1 + SENSING.bev.foretold, 16, 8)
    assert both["drivable"].shape == (2, 16, 8, 1)
    for name in ("drivable", "occupied"):
        assert 0 < both[name].min() < both[name].max() < 1
    other = model.encode(**{**given, "camera": 255 - given["camera"]})
    assert (other["features"] - both["features"]).abs().max() > 1e-4


@pytest.mark.parametrize(
    ("config", "changed", "said"),
    [
        (GOALFLOW, {"ground_sight": True}, "ground_sight: expected false without sensors"),
        (GOALFLOW, {"sensors": True}, "bev: expected uint8 of sides .* multiples of 16"),
        (SENSING, {"bev": BevLayout(rows=40)}, "bev: expected uint8 of sides .* multiples of 16"),
    ],
)
def test_what_does_not_go_together_is_named(
    config: GoalFlowConfig, changed: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        replace(config, **changed)
