"""Finishing: smoothing, projection, and what `safe` is allowed to mean."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from anchorflow_models.generation import AnchorTensors, GeneratorConfig, TrajectoryGenerator
from anchorflow_trajectory.spline.basis import Ends, spline_basis

BENT = torch.tensor([0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])  # at every step, the ends too


@pytest.fixture
def finish(gaussian_flow: Callable, room: Any) -> Callable[..., AnchorTensors]:
    """64 anchors of seed 0 on their way through the block, finished as the settings say."""

    def finished(flow: dict | None = None, **settings: Any) -> AnchorTensors:
        generator = TrajectoryGenerator(gaussian_flow(**flow or {}), GeneratorConfig(**settings))
        return generator.generate(*room.ends, seed=0)

    return finished


def test_smoothing_meets_both_ends_and_keeps_derivatives_true(finish: Callable, room: Any) -> None:
    rough = finish({"shift": BENT}, smooth=False, project=False)
    smooth = finish({"shift": BENT}, smooth=True, project=False)
    _, x_curr, x_goal = room.ends
    ends = torch.cat([smooth.trajectories[:, 0], smooth.velocities[:, 0]], -1)
    torch.testing.assert_close(ends, torch.tensor(x_curr[:4]).expand(64, -1), atol=5e-5, rtol=0)
    ends = torch.cat([smooth.trajectories[:, -1], smooth.velocities[:, -1]], -1)
    torch.testing.assert_close(ends, torch.tensor(x_goal).expand(64, -1), atol=1e-5, rtol=0)
    assert float((rough.trajectories[:, 0] - torch.tensor(x_curr[:2])).norm(dim=-1).min()) > 0.4
    basis, lasts = spline_basis(32, num_control_points=12), smooth.durations[:, None, None]
    own_time = (smooth.trajectories, smooth.velocities * lasts, smooth.accelerations * lasts**2)
    between = Ends(np.array(x_curr, np.float32), np.array(x_goal, np.float32))
    splines = basis.fit(torch.cat(own_time, -1).numpy(), between, smooth.durations.numpy())
    np.testing.assert_allclose(basis.states(splines)[2], smooth.accelerations, atol=1e-2)


def test_projection_makes_anchors_safe(finish: Callable) -> None:
    drawn, projected = finish(project=False), finish(project=True)
    assert float(drawn.safe.float().mean()) < 0.4
    assert float(projected.safe.float().mean()) > 0.9
    assert float(projected.scores.mean()) > float(drawn.scores.mean())


def test_the_margin_is_in_metres(gaussian_flow: Callable, room: Any) -> None:
    """Energy alone wants to pass as near as it may."""
    tenths = []
    for margin in (0.0, 0.5):
        config = GeneratorConfig(safety_margin=margin, refine_steps=60)
        generator = TrajectoryGenerator(gaussian_flow(), config)
        anchors = generator.generate(*room.ends, w_style=(0.0, 1.0, 0.0), seed=0)
        tenths.append(float(anchors.clearance.quantile(0.1)))
    assert tenths == pytest.approx([0.0, 0.5], abs=0.1)


def test_more_descents_cost_less(finish: Callable) -> None:
    few, many = (finish(refine_steps=n).scores.median() for n in (2, 40))
    assert float(many) > float(few)


def test_safe_is_what_was_checked_between_the_steps_too(gaussian_flow: Callable) -> None:
    """A wall of one cell stands where the anchors' samples leap over it."""
    flow = gaussian_flow()
    flow.prior.set_covariance(1e-10 * np.eye(flow.prior.rank))  # all anchors are the rest curve
    generator = TrajectoryGenerator(
        flow, GeneratorConfig(num_samples=2, smooth=False, project=False)
    )
    free = np.zeros((1, 80, 80), np.float32)
    x_curr, x_goal = [-3.0, 0.05, 0, 0, 0, 0], [3.0, 0.05, 0, 0]
    samples = generator.generate(free, x_curr, x_goal, robot_radius=0.0).trajectories[0, :, 0]
    jumped = float(samples[15] + samples[16]) / 2
    walled = free.copy()
    walled[0, :, int((jumped + 4.0) / 0.1)] = 1.0
    leapt = samples.numpy()
    columns = ((leapt + 4.0) / 0.1).astype(int)
    assert not walled[0, 40, columns].any()  # every sample is in a free cell

    assert generator.generate(free, x_curr, x_goal, robot_radius=0.0).safe.all()
    over_the_wall = generator.generate(walled, x_curr, x_goal, robot_radius=0.0)
    assert not over_the_wall.safe.any()
    assert float(over_the_wall.clearance.max()) < 0


def test_safe_keeps_the_limits(gaussian_flow: Callable, free_room: Any) -> None:
    config = GeneratorConfig(num_samples=4, smooth=False, project=False)
    hasty = torch.tensor([0.0] * 6 + [-0.7])  # the same ways in half the time
    for shift, safe in ((torch.zeros(7), True), (hasty, False)):
        flow = gaussian_flow(shift=shift)
        flow.prior.set_covariance(1e-10 * np.eye(flow.prior.rank))
        anchors = TrajectoryGenerator(flow, config).generate(*free_room.ends)
        assert (anchors.safe == safe).all()
