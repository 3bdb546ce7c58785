"""DiffusionDriveV2's losses and advantages, by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from anchorflow_training.driving.losses import (
    FAILED,
    advantages,
    pose_distance,
)

T = 8


def test_advantages_by_hand() -> None:
    # Two anchors, three samples each, groups one after another; they differ in EP.
    told = torch.ones(1, 6, 5)
    told[0, :, 2] = torch.tensor([0.2, 0.9, 0.4, 0.9, 0.6, 0.9])
    told[0, 3, 0] = 0.5
    score = [(5 * ep + 5 + 2) / 12 for ep in (0.2, 0.4, 0.6)]
    spread = float(np.std(score, ddof=1))
    found = advantages(told, 2)[0]
    # The first anchor's samples are 0, 2 and 4: only the last lies above their mean. The second's
    # are 1, 3 and 5, of which one collided.
    assert found[[0, 2]].tolist() == [0.0, 0.0]
    assert found[4].item() == pytest.approx((score[2] - score[1]) / spread, rel=1e-4)
    assert found[3].item() == FAILED
    assert (found[[1, 5]] > 0).all()


def test_headings_are_apart_the_short_way_round() -> None:
    poses, others = torch.zeros(2, T, 3), torch.zeros(2, T, 3)
    poses[0, :, 2], others[0, :, 2] = 3.1, -3.1
    others[1, :, 0] = 3.0
    expected = torch.tensor([(2 * np.pi - 6.2) / 3, 1.0])
    torch.testing.assert_close(pose_distance(poses, others), expected, atol=1e-5, rtol=0)
