"""Units, Bezier curves and lookups along trajectories, against closed forms."""

from __future__ import annotations

import math

import pytest
import torch
from small_configs import DIFFUSIONDRIVE as CONFIG
from torch import Tensor
from torch.nn import functional as F

from anchorflow_models.diffusiondrive.trajectories import (
    MOST,
    TrajectorySpace,
    Variants,
    embedded_poses,
    motion_features,
)
from anchorflow_models.layers.places import lookup_sum
from anchorflow_models.transfuser import bev_places

TIMES = 0.5 * torch.arange(1, 9)


def arc(speed: float, curvature: float) -> Tensor:
    """[1, 1, T, 3]"""
    heading = speed * curvature * TIMES
    x, y = heading.sin() / curvature, (1 - heading.cos()) / curvature
    return torch.stack([x, y, heading], -1)[None, None]


def variants(poses: Tensor, *noise: tuple[float, float]) -> Tensor:
    """[N V, T, 3]"""
    return Variants(CONFIG)(poses, torch.tensor([[[*noise]]]))[0]


def test_units_and_back() -> None:
    space = TrajectorySpace(CONFIG)
    points = torch.tensor([[0.0, 0.0], [55.7, 26.0], [-1.2, -20.0], [30.0, -5.0]])
    torch.testing.assert_close(space.metric(space.normalised(points)), points)
    torch.testing.assert_close(space.normalised(points)[1:3], torch.tensor([[1.0, 1], [-1, -1]]))
    # What lies beyond is drawn to the edge.
    torch.testing.assert_close(space.metric(torch.tensor([3.0, -3.0])), torch.tensor([55.7, -20.0]))


def test_a_polynomial_path_is_its_own_curve() -> None:
    x, y = 4 * TIMES + 0.75 * TIMES**2, 0.1 * TIMES**3
    heading = torch.atan2(0.3 * TIMES**2, 4 + 1.5 * TIMES)
    path = torch.stack([x, y, torch.zeros(8)], -1)[None, None]
    expected = torch.stack([x, y, heading], -1)[None]
    torch.testing.assert_close(variants(path, (0.0, 0.0)), expected, atol=1e-4, rtol=1e-5)


def test_an_arc_keeps_its_heading() -> None:
    path = arc(6.0, 0.05)
    torch.testing.assert_close(variants(path, (0.0, 0.0)), path[0], atol=5e-3, rtol=0)


def test_factors_scale_with_the_path() -> None:
    path = arc(6.0, 0.05)
    longer, wider = variants(path, (1.0, 0.0), (0.0, -2.0))
    base = variants(path, (0.0, 0.0))[0]
    torch.testing.assert_close(longer[:, 0], 1.1 * base[:, 0], atol=1e-4, rtol=0)
    torch.testing.assert_close(longer[:, 1], base[:, 1], atol=1e-4, rtol=0)
    torch.testing.assert_close(wider[:, 1], 0.8 * base[:, 1], atol=1e-4, rtol=0)
    # The direction of a curve whose y is scaled: tan is.
    expected = torch.atan(0.8 * base[:, 2].tan())
    torch.testing.assert_close(wider[:, 2], expected, atol=1e-3, rtol=0)


def test_who_stands_keeps_the_heading_that_was_given() -> None:
    path = torch.zeros(1, 1, 8, 3)
    path[..., 2] = 0.3
    torch.testing.assert_close(variants(path, (2.0, 2.0)), path[0])


def test_noise_on_points_is_smoothed() -> None:
    torch.manual_seed(0)
    path = arc(8.0, 0.02)
    rough = path.clone()
    rough[..., :2] += 0.3 * torch.randn(1, 1, 8, 2)
    smooth = variants(rough, (0.0, 0.0))[..., :2]
    jerk = lambda points: points.diff(dim=-2).diff(dim=-2).diff(dim=-2).square().sum()  # noqa: E731
    assert jerk(smooth) < 0.7 * jerk(rough[..., :2])


def test_a_pose_is_told_by_its_embedding() -> None:
    poses = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.1], [60, -20, -3]])
    told = embedded_poses(poses[:, None].expand(-1, 8, -1))
    assert told.shape == (5, 8 * 96)
    apart = torch.cdist(told, told) + 10 * torch.eye(5)
    assert apart.min() > 0.5


@pytest.mark.parametrize(
    ("point", "row", "column"),
    [((28.0, 24.0), 1, 1), ((28.0, -24.0), 1, 13), ((-28.0, 24.0), 14, 1), ((4.0, 8.0), 7, 5)],
)
def test_rows_go_backwards_and_columns_to_the_right(
    point: tuple[float, float], row: int, column: int
) -> None:
    values = torch.zeros(1, 16, 16, 1)
    values[0, row, column] = 1.0
    places = bev_places(torch.tensor([[[point]]]), 32.0)
    assert lookup_sum(values, places, torch.ones(1, 1, 1)).item() == pytest.approx(0.25)


def test_a_lookup_is_the_weighted_sum_of_samples() -> None:
    torch.manual_seed(0)
    values, places = torch.randn(2, 9, 12, 5), 2.4 * torch.rand(2, 7, 8, 2) - 1.2
    weights = torch.rand(2, 7, 8).softmax(-1)
    channels_first = values.permute(0, 3, 1, 2)
    sampled = F.grid_sample(channels_first, places, padding_mode="border", align_corners=False)
    expected = (sampled * weights[:, None]).sum(-1).transpose(1, 2)
    torch.testing.assert_close(lookup_sum(values, places, weights), expected, atol=1e-5, rtol=1e-4)


def test_shares_of_the_values_are_looked_up_each_by_its_own_weights() -> None:
    torch.manual_seed(0)
    values, places = torch.randn(2, 9, 12, 6), 2 * torch.rand(2, 7, 8, 2) - 1
    weights = torch.rand(2, 7, 3, 8)
    shares = zip(values.chunk(3, -1), weights.unbind(2), strict=True)
    expected = torch.cat([lookup_sum(value, places, own) for value, own in shares], -1)
    torch.testing.assert_close(lookup_sum(values, places, weights), expected)


def test_who_keeps_his_speed_feels_nothing() -> None:
    path = arc(6.0, 1e-6).nan_to_num()
    told = motion_features(path, torch.tensor([[6.0, 0.0, 0.0, 0.0]]))[0, 0]
    rates = told[4:].unflatten(0, (8, 5))
    torch.testing.assert_close(told[:4], torch.tensor([0.6, 0.0, 0.0, 0.0]))
    torch.testing.assert_close(rates[:, 0], torch.full((8,), 0.6), atol=1e-5, rtol=0)
    assert rates[:, 1:].abs().max() < 1e-4


def test_a_candidate_is_told_from_the_ego_s_own_motion() -> None:
    # 2 m/s² from 4 m/s: mean speeds of steps rise by 1 m/s each, the first from half a step ago.
    path = torch.stack([4 * TIMES + TIMES**2, 0 * TIMES, 0 * TIMES], -1)[None, None]
    same, slow = (
        motion_features(path, torch.tensor([[v, 0.0, 2.0, 0.0]]))[0, 0, 4:].unflatten(0, (8, 5))
        for v in (4.0, 3.0)
    )
    torch.testing.assert_close(same[:, 0], (4 + 2 * (TIMES - 0.25)) / 10)
    torch.testing.assert_close(same[:, 1], torch.full((8,), 2 / 3), atol=1e-5, rtol=0)
    assert same[:, 2].abs().max() < 1e-4
    # The first quarter of a second from 3 m/s has 4 m/s² more, which is out of bounds.
    assert slow[0, 1].item() == pytest.approx(6 / 3, abs=1e-4)
    assert slow[0, 2].item() == pytest.approx(16 / 6, abs=1e-3)
    torch.testing.assert_close(slow[2:], same[2:], atol=1e-5, rtol=0)
    far = motion_features(10 * path, torch.zeros(1, 4))
    assert far.abs().max() == MOST


def test_turns_are_told_the_short_way_round() -> None:
    path = arc(4.0, 0.25)
    path[..., 2] = torch.atan2(path[..., 2].sin(), path[..., 2].cos())
    rates = motion_features(path, torch.tensor([[4.0, 0, 0, 4.0]]))[0, 0, 4:].unflatten(0, (8, 5))
    torch.testing.assert_close(rates[:, 3], torch.full((8,), 2.0), atol=1e-4, rtol=0)


def test_the_heading_of_a_u_turn_is_not_torn() -> None:
    # atan alone fails beyond a quarter turn.
    path = arc(4.0, 0.2)
    heading = variants(path, (0.0, 0.0))[0, :, 2]
    turned = (heading - path[0, 0, :, 2] + math.pi) % (2 * math.pi) - math.pi
    assert turned.abs().max() < 0.05
