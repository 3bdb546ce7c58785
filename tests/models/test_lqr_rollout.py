"""The rollout of a tracked trajectory, compared with the PDM score's controller."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from anchorflow_driving.window import WHEELBASE as OF_NAVSIM, EgoState
from anchorflow_models.goalflow.ways import roll_out
from anchorflow_models.lqr_rollout import WHEELBASE, Start, driven, halved
from anchorflow_trajectory.car.tracking import interpolate, track

T, DT, AXLES = 8, 0.5, 2.9


def plan(speed: float, pull: list[float], bend: list[float]) -> Tensor:
    """Poses [T, 3] by m/s² and 1/m, each for half of the time."""
    controls = (torch.tensor(each).repeat_interleave(T // 2) for each in (pull, bend))
    return roll_out(torch.tensor(speed), *controls, dt=DT)


def follow(poses: Tensor, speed: float, pull: float, bend: float) -> tuple[Tensor, Tensor]:
    """Poses [T, 3] and speeds [T] of one car that moves so now."""
    start = Start(*(torch.tensor([each]) for each in (speed, pull, bend, AXLES)))
    followed, speeds = driven(poses[None, None], start, dt=DT)
    return followed[0, 0], speeds[0, 0]


@pytest.mark.parametrize(
    ("speed", "now", "pull", "bend"),
    [
        (8.0, (0.0, 0.0), [0.0, 0.0], [0.0, 0.0]),
        (8.0, (0.0, 0.0), [-5.0, 0.0], [0.0, 0.0]),
        (2.0, (1.0, 0.0), [-3.0, 0.0], [0.0, 0.0]),
        (4.0, (0.0, 0.0), [1.5, 0.5], [0.0, 0.0]),
        (5.0, (0.0, -0.2), [0.0, 0.5], [0.05, 0.0]),
        (6.0, (-1.0, 0.1), [-1.0, 1.0], [0.15, -0.1]),
        (10.0, (0.0, 0.0), [0.0, 0.0], [0.04, -0.04]),
    ],
    ids=["steady", "halt", "halt_in_a_creep", "pull", "out_of_a_corner", "corner", "lanes"],
)
def test_it_drives_what_the_pdm_scores_controller_drives(
    speed: float, now: tuple[float, float], pull: list[float], bend: list[float]
) -> None:
    poses = plan(speed, pull, bend)
    told = np.concatenate([np.zeros((1, 3)), poses.double().numpy()])[None]
    motion = track(interpolate(told), EgoState(np.zeros(3), speed, *now), wheelbase=AXLES)
    wanted, wanted_speed = (torch.from_numpy(a[0, 5::5]) for a in (motion.poses, motion.speed))
    followed, speeds = follow(poses, speed, *now)
    away, planned = ((each - wanted)[:, :2].norm(dim=-1).amax() for each in (followed, poses))
    assert away < 0.1 + 0.2 * planned
    assert (followed - wanted)[:, 2].abs().amax() < 0.1
    assert (speeds - wanted_speed).abs().amax() < 0.3


def test_every_trajectory_is_followed_by_itself() -> None:
    torch.manual_seed(0)
    poses = roll_out(
        torch.full((2, 3), 6.0), torch.randn(2, 3, T), 0.1 * torch.randn(2, 3, T), dt=DT
    )
    start = Start(
        *(torch.tensor(each) for each in ([6.0, 5.0], [0.5, 0.0], [0.1, 0.0], [2.9, 3.1]))
    )
    together = driven(poses, start, dt=DT)
    for scene, anchor in ((0, 2), (1, 0)):
        one = Start(*(each[scene : scene + 1] for each in start))
        alone = driven(poses[scene : scene + 1, anchor : anchor + 1], one, dt=DT)
        for all_of_them, mine in zip(together, alone, strict=True):
            torch.testing.assert_close(all_of_them[scene, anchor], mine[0, 0])


@pytest.mark.parametrize(("count", "dt"), [(1, 0.5), (3, 1.0), (40, 0.1)])
def test_a_plan_of_any_length_is_followed(count: int, dt: float) -> None:
    still = torch.zeros(1, 2, count, 3)
    start = Start(*(torch.tensor([each]) for each in (1.0, 0.0, 0.0, AXLES)))
    followed, speed = driven(still, start, dt=dt)
    assert followed.shape == still.shape
    assert (speed[..., -1] < 1.0).all()
    assert (followed[..., -1, 0] > 0.1 * dt).all()


def test_a_pose_stands_in_the_middle_of_every_two() -> None:
    poses = torch.tensor([[2.0, 0.0, 0.2], [4.0, 1.0, 0.4]])
    middles = torch.tensor([[1.0, 0.0, 0.1], [3.0, 0.5, 0.3]])
    assert torch.equal(halved(poses)[1::2], poses)
    torch.testing.assert_close(halved(poses)[::2], middles)


def test_the_car_is_that_of_the_driving_logs() -> None:
    assert WHEELBASE == OF_NAVSIM


@pytest.mark.parametrize(
    ("motion", "bend"),
    [((8.0, 0.0, -1.0, 3.2), 0.05), ((0.4, 0.0, 0.0, 0.1), 0.1), ((-0.1, 0.0, 0.0, 0.0), 0.0)],
    ids=["turns", "creeps", "rolls_back"],
)
def test_it_starts_as_the_car_moves(motion: tuple[float, ...], bend: float) -> None:
    start = Start.of(torch.tensor([motion]), wheelbase=AXLES)
    assert [each.item() for each in start] == pytest.approx(
        [max(motion[0], 0.0), motion[2], bend, AXLES]
    )
