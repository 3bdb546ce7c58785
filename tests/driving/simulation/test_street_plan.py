"""Street plans: quarters and arterial streets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest


def test_arterial_streets_are_longer_and_faster(tmp_path: Path) -> None:
    for module in ("sumo", "libsumo"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    from anchorflow_driving.simulation.road_net import RoadNet
    from anchorflow_driving.simulation.street_plan import (
        ARTERIAL,
        QUARTER,
        StreetKind,
        make_net,
    )

    def means(kind: StreetKind, folder: Path) -> tuple[float, float]:
        """Length [m] of the lanes between junctions, and their speed [m/s]."""
        lanes = []
        for seed in range(3):
            place = folder / str(seed)
            place.mkdir(parents=True)
            net = RoadNet(make_net(np.random.default_rng(seed), place, kind=kind))
            lanes += [lane for lane in net.lanes.values() if not lane.in_junction]
        lengths, speeds = zip(*[(lane.sumo_length, lane.speed) for lane in lanes], strict=True)
        return float(np.mean(lengths)), float(np.mean(speeds))

    (length, speed), (longer, faster) = (
        means(kind, tmp_path / name)
        for kind, name in ((QUARTER, "quarter"), (ARTERIAL, "arterial"))
    )

    assert longer > 1.5 * length
    assert faster > 1.2 * speed
