"""Settings reach the finish, which `tests/trajectory/finish` tests by itself."""

from __future__ import annotations

from typing import Any

import pytest
from flowmp_scenes import ROOM, GaussianFlow

from anchorflow_models.generation import AnchorTensors, GeneratorConfig, TrajectoryGenerator


def finish(flow: dict | None = None, **settings: Any) -> AnchorTensors:
    """64 anchors of seed 0 on their way through the block, finished as the settings say."""
    generator = TrajectoryGenerator(GaussianFlow(**flow or {}), GeneratorConfig(**settings))
    return generator.generate(*ROOM.ends, seed=0)


def test_projection_makes_anchors_safe() -> None:
    drawn, projected = finish(project=False), finish(project=True)
    assert float(drawn.safe.float().mean()) < 0.4
    assert float(projected.safe.float().mean()) > 0.9
    assert float(projected.scores.mean()) > float(drawn.scores.mean())


def test_the_margin_is_in_metres() -> None:
    """Energy alone wants to pass as near as it may."""
    tenths = []
    for margin in (0.0, 0.5):
        config = GeneratorConfig(safety_margin=margin, refine_steps=60)
        generator = TrajectoryGenerator(GaussianFlow(), config)
        anchors = generator.generate(*ROOM.ends, w_style=(0.0, 1.0, 0.0), seed=0)
        tenths.append(float(anchors.clearance.quantile(0.1)))
    assert tenths == pytest.approx([0.0, 0.5], abs=0.1)


def test_more_descents_cost_less() -> None:
    few, many = (finish(refine_steps=n).scores.median() for n in (2, 40))
    assert float(many) > float(few)
