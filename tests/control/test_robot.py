"""A robot's arguments, and the discs that stand for its body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorRequest, InvalidRequest
from anchorflow_control import MppiConfig, MppiController, Robot
from anchorflow_control.body import OVERHANG, discs_of

DISC: dict[str, Any] = {"kind": "differential", "v_max": 1.0, "a_max": 1.5, "radius": 0.3}
CART = [[0.45, 0.31], [-0.45, 0.31], [-0.45, -0.31], [0.45, -0.31]]
WEDGE = [[1.0, 0.0], [-0.5, 0.4], [-0.5, -0.4]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "tank"}, "kinematics.kind: expected one of omni, differential, ackermann"),
        ({"kind": "ackermann"}, "kinematics.min_turning_radius: expected a radius above 0"),
        ({"v_max": -1.0}, r"v_max: expected a number in \(0, 100\] m/s, got -1"),
        ({"a_max": "2"}, "a_max: expected a number"),
        ({"omega_max": 0.0}, "kinematics.omega_max: expected a number in"),
        ({"alpha_max": np.nan}, "alpha_max: expected a number"),
        ({"reverse": 1}, "kinematics.reverse: expected true or false"),
        ({"reverse_v_max": 0}, "reverse_v_max: expected a number"),
        ({"radius": None}, "expected a radius or a footprint, and not both, got null"),
        ({"footprint": CART}, "expected a radius or a footprint, and not both, got 0.3"),
        ({"radius": None, "footprint": CART[:2]}, "footprint: expected 3 to 16 corners, got 2"),
    ],
)
def test_a_wrong_argument_is_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        Robot(**DISC | given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"motions": 8}, r"motions: expected an integer in \[16, 65536\], got 8"),
        ({"steps": 40.5}, "steps: expected an integer"),
        ({"temperature": 0.0}, "temperature: expected a number"),
        ({"margin": np.inf}, "margin: expected a number"),
    ],
)
def test_a_wrong_setting_is_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MppiConfig(**given)


def test_a_wrong_tick_is_named() -> None:
    with pytest.raises(InvalidRequest, match="tick_s: expected a number in"):
        MppiController(Robot(**DISC), tick_s=0.0)


@pytest.mark.parametrize("kind", ["omni", "differential", "ackermann"])
@pytest.mark.parametrize("body", [{"radius": 0.3}, {"footprint": CART}])
def test_its_options_are_fields_of_a_request(kind: str, body: dict[str, Any]) -> None:
    robot = Robot(kind=kind, v_max=1.2, a_max=1.5, min_turning_radius=0.5, **body)
    heading = [] if robot.is_omni else [0.0]
    request = AnchorRequest.build(
        cost_map={"data": np.zeros((1, 32, 32), np.float32), "resolution": 0.2},
        x_curr=[-1.0, 0.0, *heading] + [0.0] * (4 + 2 * len(heading)),
        x_goal=[1.0, 0.0, *heading] + [0.0] * (2 + len(heading)),
        **robot.options,
    )

    assert request.v_max == 1.2
    assert (request.kinematics is None) == robot.is_omni
    assert (request.footprint is None) == ("radius" in body)
    assert robot.v_min == 0.0


def test_speed_backwards() -> None:
    assert Robot(**DISC, reverse=True).v_min == -1.0
    assert Robot(**DISC, reverse=True, reverse_v_max=0.4).v_min == -0.4


@pytest.mark.parametrize("corners", [CART, WEDGE, [[3.6, 0.9], [3.6, -0.9], [-1, -0.9], [-1, 0.9]]])
def test_discs_cover_the_outline_and_hardly_more(corners: list[list[float]]) -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, footprint=corners)
    discs = discs_of(robot).astype(np.float64)
    edges = np.array(robot.footprint)
    share = np.linspace(0.0, 1.0, 200)[:, None, None]
    outline = (edges + share * (np.roll(edges, -1, 0) - edges)).reshape(-1, 2)
    apart = np.linalg.norm(outline[:, None] - discs[:, :2], axis=-1) - discs[:, 2]
    # How far each disc stands out beyond the nearest edge.
    along = np.roll(edges, -1, 0) - edges
    outward = np.stack([along[:, 1], -along[:, 0]], 1) / np.linalg.norm(along, axis=1)[:, None]
    out = ((discs[:, None, :2] - edges) * outward).sum(-1).max(1) + discs[:, 2]
    half_width = 0.5 * min(np.ptp(edges, axis=0))

    assert apart.min(1).max() < 0.01 * half_width
    assert out.max() <= 1.01 * OVERHANG * half_width
    assert len(discs) <= 32
    assert discs[:, 2].argmax() == 0


def test_a_disc_is_one_disc() -> None:
    np.testing.assert_allclose(discs_of(Robot(**DISC)), [[0.0, 0.0, 0.3]])
