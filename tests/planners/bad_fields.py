"""Values of request fields that every reader of a request refuses, and bytes that are no JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

NAN, INF = float("nan"), float("inf")


def occupied_at(row: int, column: int) -> list[Any]:
    """Return the data of a map of 16 x 20 cells, one of them half occupied."""
    grid = np.zeros((1, 16, 20))
    grid[0, row, column] = 0.5
    return grid.tolist()


TRACK: dict[str, Any] = {"position": [[1, 0]], "velocity": [[0, 1]], "radius": [0.3]}
BAD_OBSTACLES: list[tuple[str, Any, list[str]]] = [
    ("position", None, ["required"]),
    ("position", [1, 0], ["[M,2]", "[2]"]),
    ("position", np.zeros((129, 2)).tolist(), ["M from 0 to 128", "[129, 2]"]),
    ("velocity", None, ["required without a forecast"]),
    ("velocity", [[NAN, 0]], ["finite", "nan", "obstacles.velocity[0][0]"]),
    ("velocity", [[None, 0]], ["a number", "null", "obstacles.velocity[0][0]"]),
    ("velocity", [[0, -101]], ["[-100, 100] m/s", "-101"]),
    ("velocity", [[0, 1], [1, 0]], ["M = 1 as in obstacles.position", "2"]),
    ("radius", None, ["required"]),
    ("radius", [-0.1], ["[0, 100] m", "-0.1"]),
    ("radius", [[0.1]], ["[M]", "[1, 1]"]),
    ("forecast_dt", 0.4, ["none without a forecast", "0.4"]),
    ("growth", -1, ["[0, 100] m/s", "-1"]),
    ("mass", [80], ["unknown field"]),
]
SQUARE = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
BAD_BODIES: list[tuple[str, Any, list[str]]] = [
    ("footprint", [[0, 1], [1, 0]], ["3 to 16 corners", "2"]),
    ("footprint", [0.3, 0.2], ["[K,2]", "[2]"]),
    ("footprint", [*SQUARE[:3], [0.5, 0]], ["convex polygon", "0.5"]),
    ("footprint", [SQUARE[k] for k in (0, 2, 1, 3)], ["convex polygon"]),
    ("footprint", (np.array(SQUARE) + 3.0).tolist(), ["about (0, 0)"]),
    ("footprint", [*SQUARE[:3], [-30, 1]], ["[-20, 20] m", "-30"]),
    ("kinematics", {}, ["required"]),
    ("kinematics.kind", "tracked", ["one of omni, differential, ackermann", "tracked"]),
    ("kinematics.min_turning_radius", -1, ["[0, 100] m", "-1"]),
    ("kinematics.omega_max", 0, ["(0, 100] rad/s", "0"]),
    ("kinematics.reverse", "no", ["true or false", "'no'"]),
    ("kinematics", {"kind": "ackermann"}, ["above 0 m for ackermann"]),
]
BAD_FIELDS: list[tuple[str, Any, list[str]]] = [
    ("x_curr", [0, 0, 0], ["[6] or [B,6]", "[9] or [B,9]", "[3]"]),
    ("x_curr", [[[0] * 6]], ["[6] or [B,6]", "[1, 1, 6]"]),
    ("x_curr", [0, 0, 0, 0, 0, "abc"], ["a number", "the string 'abc'", "x_curr[5]"]),
    ("x_curr", "abc", ["a list of numbers", "the string 'abc'"]),
    ("x_curr", [0, 0, True, 0, 0, 0], ["the boolean true", "x_curr[2]"]),
    ("x_curr", [0, 0, None, 0, 0, 0], ["null", "x_curr[2]"]),
    ("x_curr", [0, 0, {}, 0, 0, 0], ["an object", "x_curr[2]"]),
    ("x_curr", [0, 0, [0], 0, 0, 0], ["a list of 1", "x_curr[2]"]),
    ("x_curr", [[0] * 6, 7], ["a list", "x_curr[1]", "7"]),
    ("x_curr", [[0] * 6, [0] * 5], ["x_curr[1]", "a list of 5"]),
    ("x_curr", [], ["[6] or [B,6]", "[0]"]),
    ("x_curr", [NAN, 0, 0, 0, 0, 0], ["finite", "nan", "x_curr[0]"]),
    ("x_curr", [0, 0, 0, 0, 0, -INF], ["finite", "-inf", "x_curr[5]"]),
    ("x_curr", [10**400, 0, 0, 0, 0, 0], ["finite"]),
    ("x_curr", [1e30, 0, 0, 0, 0, 0], ["[-1e+07, 1e+07] m", "1e+30"]),
    ("x_curr", [0, 0, 0, -500, 0, 0], ["[-100, 100] m/s", "-500.0", "x_curr[3]"]),
    ("x_curr", [[0] * 6, [0] * 5 + [1e4]], ["[-100, 100] m/s^2", "10000.0", "x_curr[1][5]"]),
    ("x_goal", [0, 0, 3000, 0], ["[-100, 100] m/s", "3000.0", "x_goal[2]"]),
    ("x_curr", np.array(["a"] * 6), ["numbers", "<U1"]),
    ("x_curr", np.array(1.0), ["[6] or [B,6]", "[]"]),
    ("x_goal", np.array(np.nan), ["finite", "nan"]),
    ("w_style", np.array(0.5), ["[3] or [B,3]", "[]"]),
    ("cost_map.data", np.array(0.0), ["[C,H,W] or [B,C,H,W]", "[]"]),
    ("cost_map.origin", np.array(0.0), ["[2]", "[]"]),
    ("sampler.schedule", np.array(1.0), ["[K]", "[]"]),
    ("warm_start.trajectory", np.array(1.0), ["[T,2] to [T,6]", "[]"]),
    ("x_curr", [6, 0, 0, 0, 0, 0], ["on the map", "x from -5 to 5", "(6, 0)"]),
    ("x_goal", [0, -4.1, 0, 0], ["on the map", "y from -4 to 4", "(0, -4.1)"]),
    ("x_goal", [0] * 6, ["[4] or [B,4]", "[6]"]),
    ("x_curr", [0] * 8, ["[6] or [B,6]", "[9] or [B,9]", "[8]"]),
    ("w_style", [0.5, -0.1, 0.6], ["-0.1", "w_style[1]"]),
    ("w_style", [0, 0, 0], ["above 0", "zeros"]),
    ("w_style", [1, 1], ["[3] or [B,3]", "[2]"]),
    ("w_style", "fast", ["conservative, balanced, efficient, comfortable", "'fast'"]),
    ("w_style", ["efficient"] * 3, ["number at w_style[0]", "'efficient'"]),
    ("num_samples", 0, ["1 to 512", "0"]),
    ("num_samples", 513, ["1 to 512", "513"]),
    ("num_samples", 64.0, ["integer", "64.0"]),
    ("num_samples", "64", ["integer", "the string '64'"]),
    ("num_samples", True, ["integer", "the boolean true"]),
    ("robot_radius", -0.1, ["[0, 5] m", "-0.1"]),
    ("robot_radius", "wide", ["a number", "'wide'"]),
    ("robot_radius", NAN, ["nan"]),
    ("v_max", 0, ["(0, 100] m/s"]),
    ("a_max", False, ["the boolean false"]),
    ("horizon_s", 10**400, ["an integer of 1329 bits"]),
    ("model", 3, ["a string", "3"]),
    ("model", "", ["1 to 128"]),
    ("request_id", "a\nb", ["printable"]),
    ("seed", -1, ["from 0", "-1"]),
    ("seed", 2**63, ["9223372036854775807", "9223372036854775808"]),
    ("budget_ms", 0, ["ms", "0"]),
    ("sampler", "rk4", ["an object", "'rk4'"]),
    ("sampler.method", "rk5", ["rk4, heun, midpoint, euler", "'rk5'"]),
    ("sampler.schedule", "9step", ["8step", "9step"]),
    ("sampler.schedule", [0, 0.5, 0.5, 1], ["strictly increasing"]),
    ("sampler.schedule", [0, 1e-38, 1], ["times at least 1e-06 apart", "[0.0, 1e-38, 1.0]"]),
    ("sampler.schedule", [0, 0.5], ["last time of 1", "0.5"]),
    ("sampler.schedule", [0.2, 1], ["first time of 0", "0.2"]),
    ("sampler.schedule", [1], ["[K]", "[1]"]),
    ("sampler.schedule", {"steps": 4}, ["unknown field"]),
    ("sampler.schedule.uniform", 0, ["1 to 100", "0"]),
    ("refine.smooth", 1, ["true or false", "1"]),
    ("refine.safety_margin", -1, ["[0, 5] m"]),
    ("refine.guidance", "x", ["a number"]),
    ("refine.barrier", "yes", ["true or false", "'yes'"]),
    ("refine.certified_margin", 6, ["[0, 5] m", "6"]),
    ("warm_start.tau", 1, ["(0, 1)", "1"]),
    ("warm_start.dt", 0, ["(0, 600] s", "0"]),
    ("warm_start.dt", "0.1", ["(0, 600] s", "'0.1'"]),
    ("warm_start.dt", [0.1, 0.2], ["(0, 600] s", "a list of 2"]),
    ("warm_start.trajectory", [[0, 0, 0, 0, 0, 0, 0]] * 4, ["[T,2] to [T,6]", "[4, 7]"]),
    ("warm_start.trajectory", None, ["required"]),
    ("cost_map", [[0]], ["an object", "a list of 1"]),
    ("cost_map.data", [[[0] * 16] * 15 + [[0] * 3]], ["cost_map.data[0][15]"]),
    (
        "cost_map.data",
        [[[0] * 15 + ["abc"]] * 16],
        ["a number at cost_map.data[0][0][15]", "'abc'"],
    ),
    ("cost_map.data", [[[None] * 16] * 16], ["got null"]),
    ("cost_map.data", [[[0] * 15 + [True]] * 16], ["the boolean true"]),
    ("cost_map.data", [[[NAN] * 16] * 16], ["finite numbers", "nan"]),
    ("cost_map.data", np.zeros((16, 20)).tolist(), ["[C,H,W] or [B,C,H,W]", "[16, 20]"]),
    ("cost_map.data", np.zeros((1, 8, 20)).tolist(), ["16 to 512", "8 and 20"]),
    ("cost_map.data", np.zeros((17, 16, 16)).tolist(), ["C from 1 to 16", "17"]),
    ("cost_map.channel_weights", [1.0], ["[0], one for each channel but the first", "[1]"]),
    ("cost_penalty", 101, ["[0, 100]", "101"]),
    ("cost_penalty", -0.5, ["[0, 100]", "-0.5"]),
    ("clear_start", 1, ["true or false", "1"]),
    ("goal_tolerance", 0.5, ["an object", "0.5"]),
    ("goal_tolerance.position", -1, ["[0, 100] m", "-1"]),
    ("goal_tolerance.position", None, ["required"]),
    ("goal_tolerance", {"position": 1, "heading": 4}, ["heading", "[0, 3.14159] rad", "4"]),
    *((f"obstacles.{name}", value, words) for name, value, words in BAD_OBSTACLES),
    *BAD_BODIES,
    ("cost_map.data", np.zeros((65, 1, 16, 16)).tolist(), ["B from 1 to 64", "65"]),
    ("cost_map.data", np.full((1, 16, 20), 1.5).tolist(), ["[0, 1]", "1.5"]),
    ("cost_map.data", np.zeros((1, 1, 1, 16, 20)).tolist(), ["deeper"]),
    ("cost_map.resolution", 0, ["[1e-06, 100] m/cell", "0"]),
    ("cost_map.resolution", 1e-40, ["[1e-06, 100] m/cell", "1e-40"]),
    ("cost_map.resolution", None, ["required"]),
    ("cost_map.origin", [0, 0, 0], ["[2]", "[3]"]),
    ("cost_map.origin", [0, INF], ["finite"]),
    *((name, None, ["required"]) for name in ("cost_map", "x_curr", "x_goal")),
    ("cost_map.frame", "map", ["unknown field"]),
    ("x_cur", 1, ["did you mean 'x_curr'?"]),
    ("cost_map.resolutoin", 1, ["did you mean 'resolution'?"]),
    ("refine.smoth", 1, ["did you mean 'smooth'?"]),
]
NOT_JSON: dict[bytes, str] = {
    b'{"x_curr": [1, 2': "expected JSON, got text that breaks at position 16 of 16: ",
    b'{"id": ': "expected JSON, got text that breaks at position 7 of 7: ",
    b'{"x_curr": [1,, 2]}': "expected JSON, got text that breaks at position 14 of 19: ",
    b"\xff\xfe{": "expected JSON, got text that breaks at position 0 of 3: ",
    "{}".encode("utf-16"): "expected JSON, got text that breaks at position 0 of 6: ",
    b"9" * 5000: "expected the contract's JSON, got an integer of too many digits",
    b"[1, 2]": "expected an object, got a list of 2",
    b'"text"': "expected an object, got the string 'text'",
    b"null": "expected an object, got null",
}


def with_value(fields: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Set the value of a field by its path; a warm start and obstacles have what they need."""
    *parents, name = path.split(".")
    if parents == ["warm_start"]:
        fields["warm_start"] = {"trajectory": [[0, 0], [1, 1]]}
    if parents == ["obstacles"]:
        fields["obstacles"] = dict(TRACK)
    if parents == ["kinematics"]:
        fields["kinematics"] = {"kind": "differential"}
    parent = fields
    for key in parents:
        parent = parent.setdefault(key, {})
    parent[name] = value
    return fields
