"""The ground under simulated cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driven_bend import bend

from anchorflow_driving.errors import SensorError
from anchorflow_driving.log import line_fields
from anchorflow_driving.sensors.ground import CELL, PAINT, STRIPE, paint_ground
from anchorflow_driving.window import Scenes

BEYOND = np.array([[-900.0, 0.0], [900.0, 0.0], [900.0, 3.0], [-900.0, 3.0]])
"""m, far beyond the road on all sides."""


@pytest.mark.parametrize(("family", "colour"), [("line", PAINT), ("crosswalk", STRIPE)])
def test_what_leads_beyond_the_road_is_painted_as_far_as_there_is_ground(
    family: str, colour: tuple[int, int, int]
) -> None:
    solid = np.ones(1, bool) if family == "line" else np.zeros(0, bool)
    log = replace(bend(0), **line_fields(family, [BEYOND]), line_solid=solid)
    ground = paint_ground(Scenes(log)[0].view)
    rows, columns = np.nonzero((ground.pixels == colour).all(-1))
    y, x = rows * CELL + ground.low[1], columns * CELL + ground.low[0]
    # The line is painted from end to end, without wrapping around the picture.
    assert (x.min(), x.max()) == pytest.approx(
        (ground.low[0], ground.low[0] + ground.size[0]), abs=2.0
    )
    assert (y.min(), y.max()) == pytest.approx((0.0, 3.0), abs=0.3)


def test_a_map_too_wide_to_be_drawn_is_said() -> None:
    road = np.array([[0.0, 0.0], [2010.0, 0.0], [2010.0, 9.0]])
    log = replace(bend(0), **line_fields("drivable", [road]))

    with pytest.raises(SensorError, match="expected a map of at most 2008 m to be drawn, got 2010"):
        paint_ground(Scenes(log)[0].view)
