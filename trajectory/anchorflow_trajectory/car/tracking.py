"""Roll out a plan by LQR on a kinematic bicycle, as nuPlan's simulation does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FRAME_S = 0.1
"""s between two steps of a rollout."""
PLAN_TIMES: Array = np.arange(1, 9, dtype=np.float64) * 0.5
"""s, of the 8 poses that the PDM score takes."""
STEPS = 40
"""Steps of FRAME_S in a rollout: 4 s."""
LOOKAHEAD = 10
"""Steps over which the controller holds one command."""

Q_SPEED, R_ACCELERATION = 10.0, 1.0
Q_LATERAL, Q_HEADING, R_STEERING_RATE = 1.0, 10.0, 1.0  # the steering angle itself costs nothing
STOPPING_SPEED, STOPPING_GAIN = 0.2, 0.5  # m/s, 1/s
ACCELERATION_LAG, STEERING_LAG = 0.2, 0.05  # s
MAX_STEERING = np.pi / 3

ACCELERATION_PENALTY = 1e-4
CURVATURE_PENALTY, CURVATURE_RATE_PENALTY = 1e-10, 1e-2


@dataclass(frozen=True)
class EgoState:
    """How a car moves now."""

    pose: Array  # [3] of the rear axle, in the frame of the rollout
    speed: float  # m/s along the heading, not below 0
    acceleration: float  # m/s² along the heading
    curvature: float  # 1/m, positive to the left


@dataclass(frozen=True)
class Motion:
    """The rear axle at 0, 0.1, … 4.0 s, T = 41."""

    poses: Array  # [P, T, 3]
    speed: Array  # [P, T] m/s
    acceleration: Array  # [P, T] m/s², along the heading
    yaw_rate: Array  # [P, T] rad/s

    def __getitem__(self, plans: slice) -> Motion:
        return Motion(
            self.poses[plans], self.speed[plans], self.acceleration[plans], self.yaw_rate[plans]
        )


def interpolate(poses: Array) -> Array:
    """Poses [P, n + 1, 3] evenly over 4 s -> [P, 41, 3], straight between them."""
    stride = STEPS / (poses.shape[1] - 1)
    place = np.arange(STEPS + 1) / stride
    before = np.minimum(place.astype(int), poses.shape[1] - 2)
    step = np.diff(poses, axis=1)
    step[..., 2] = wrap_angle(step[..., 2])
    return poses[:, before] + (place - before)[:, None] * step[:, before]


def track(reference: Array, start: EgoState, *, wheelbase: float) -> Motion:
    """Roll out a vehicle that follows a reference [P, 41, 3], in the frame of `start`."""
    speeds, curvatures = reference_profiles(reference)
    curvatures = np.concatenate(
        [curvatures, np.repeat(curvatures[:, -1:], LOOKAHEAD, axis=1)], axis=1
    )
    x, y, heading, speed, acceleration, steering = np.repeat(
        [[*start.pose, start.speed, start.acceleration, _steering(start, wheelbase)]],
        len(reference),
        axis=0,
    ).T
    states = np.empty((STEPS + 1, 6, len(reference)))
    for step in range(STEPS + 1):
        yaw_rate = speed * np.tan(steering) / wheelbase
        states[step] = x, y, heading, speed, acceleration, yaw_rate
        if step == STEPS:
            break
        target = speeds[:, min(step + LOOKAHEAD, STEPS - 1)]
        command = _acceleration_command(speed, target)
        rate = _steering_rate(
            np.stack([x, y, heading], -1),
            reference[:, step],
            (speed[:, None] + command[:, None] * FRAME_S * np.arange(LOOKAHEAD)) * FRAME_S,
            curvatures[:, step : step + LOOKAHEAD],
            steering / wheelbase,
            wheelbase,
        )
        stopping = (speed <= STOPPING_SPEED) & (target <= STOPPING_SPEED)
        command = np.where(stopping, STOPPING_GAIN * (target - speed), command)
        rate = np.where(stopping, 0.0, rate)
        acceleration = acceleration + _share(ACCELERATION_LAG) * (command - acceleration)
        x = x + speed * np.cos(heading) * FRAME_S
        y = y + speed * np.sin(heading) * FRAME_S
        heading = heading + yaw_rate * FRAME_S
        speed = speed + acceleration * FRAME_S
        steering = np.clip(
            steering + _share(STEERING_LAG) * rate * FRAME_S, -MAX_STEERING, MAX_STEERING
        )
    axes = states.transpose(1, 2, 0)
    return Motion(
        np.stack(list(axes[:3]), -1), speed=axes[3], acceleration=axes[4], yaw_rate=axes[5]
    )


def reference_profiles(poses: Array) -> tuple[Array, Array]:
    """Smooth speeds (m/s) and curvatures (1/m) [P, 40] that explain poses [P, 41, 3].

    Least squares of the distances and turns between the poses, with a price on the speed's and the
    curvature's rates of change.
    """
    moved = np.diff(poses[..., :2], axis=1)
    heading = poses[:, :-1, 2]
    distance = moved[..., 0] * np.cos(heading) + moved[..., 1] * np.sin(heading)
    speed = distance @ _speed_fit().T
    turn = wrap_angle(np.diff(poses[..., 2], axis=1))
    return speed, _curvature_fit(speed * FRAME_S, turn)


@cache
def _speed_fit() -> Array:
    """[40, 40]: the speeds of a row of distances.

    Speeds are a first one and 39 accelerations. NAVSIM's tracker, meant to price the change of the
    accelerations, prices their size, save for the last one's change; the score is defined by it.
    """
    speeds = np.tril(np.full((STEPS, STEPS), FRAME_S))
    speeds[:, 0] = 1.0
    priced = np.eye(STEPS)[1:-1]
    priced[-1, -1] = -1.0
    normal = FRAME_S**2 * speeds.T @ speeds + ACCELERATION_PENALTY * priced.T @ priced
    return speeds @ np.linalg.solve(normal, FRAME_S * speeds.T)


def _curvature_fit(arc: Array, turn: Array) -> Array:
    """argmin over k of |arc·k − turn|² + CURVATURE_RATE_PENALTY·|dk/dt|² + CURVATURE_PENALTY·k_0².

    A tridiagonal system a plan [P, 40], eliminated forward and backward (Thomas).
    """
    stiffness = CURVATURE_RATE_PENALTY / FRAME_S**2
    diagonal = arc**2 + 2 * stiffness
    diagonal[:, 0] += CURVATURE_PENALTY - stiffness
    diagonal[:, -1] -= stiffness
    value = arc * turn
    for step in range(1, STEPS):
        factor = stiffness / diagonal[:, step - 1]
        diagonal[:, step] -= factor * stiffness
        value[:, step] += factor * value[:, step - 1]
    value[:, -1] /= diagonal[:, -1]
    for step in reversed(range(STEPS - 1)):
        value[:, step] = (value[:, step] + stiffness * value[:, step + 1]) / diagonal[:, step]
    return value


def _acceleration_command(speed: Array, target: Array) -> Array:
    """The one acceleration over the look-ahead that costs least."""
    time = LOOKAHEAD * FRAME_S
    return time * Q_SPEED / (time**2 * Q_SPEED + R_ACCELERATION) * (target - speed)


def _steering_rate(
    pose: Array, wanted: Array, arc: Array, curvature: Array, present: Array, wheelbase: float
) -> Array:
    """The one steering rate [P] over the look-ahead that costs least.

    pose, wanted: [P, 3]; arc: [P, LOOKAHEAD] m of each step; curvature: [P, LOOKAHEAD] of the
    reference there; present: [P] curvature of the present steering angle, linearised
    """
    offset, heading = pose[:, :2] - wanted[:, :2], wanted[:, 2]
    lateral = offset[:, 1] * np.cos(heading) - offset[:, 0] * np.sin(heading)
    error = wrap_angle(pose[:, 2] - heading)
    turn = arc * (present[:, None] - curvature)
    turn_of_rate = arc * (np.arange(LOOKAHEAD) * FRAME_S / wheelbase)
    # A turn at one step shifts the remaining steps sideways.
    rest = arc.sum(1, keepdims=True) - arc.cumsum(1)
    lateral = lateral + error * arc.sum(1) + (turn * rest).sum(1)
    lateral_of_rate = (turn_of_rate * rest).sum(1)
    error = wrap_angle(error + turn.sum(1))
    error_of_rate = turn_of_rate.sum(1)
    gain = Q_LATERAL * lateral_of_rate * lateral + Q_HEADING * error_of_rate * error
    return -gain / (Q_LATERAL * lateral_of_rate**2 + Q_HEADING * error_of_rate**2 + R_STEERING_RATE)


def _steering(start: EgoState, wheelbase: float) -> float:
    return float(np.clip(np.arctan(start.curvature * wheelbase), -MAX_STEERING, MAX_STEERING))


def _share(lag: float) -> float:
    """Return the share of a command that a first-order lag passes on in one step."""
    return FRAME_S / (FRAME_S + lag)


def wrap_angle(angle: Array) -> Array:
    """The same angle in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
