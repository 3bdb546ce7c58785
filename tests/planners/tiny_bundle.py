"""A bundle small enough to be worked out by hand.

The bundle's prior is the scene's routes, and its field carries every anchor by the same amount,
and on its own route by half as fast again as that was:

    x_0 = mean + noise · basis          R = 3: one number moves all of p, one all of p' and one all
                                        of log duration
    dx/dt = 4 t³ · channel means + PULL · mean
                                        so x_1 = x_0 + channel means + PULL · mean, exactly, by
                                        Simpson's rule

The means of occupancy, traversability and risk move (p_x, p_y, p'_x) and once more (p'_y, p''_x,
p''_y); PULL is one half for p' and nothing else.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from written_graphs import tensor, write_graphs, write_manifest

T, S, R = 8, 7, 3
TWICE, THRICE = "(modulation, modulation)", "(modulation, modulation, modulation)"
PULL = np.array([0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0], np.float32)

ENCODE = """
<ir_version: 10, opset_import: ["": 20]>
encode (float[B,3,H,W] cost_map, float[B,6] x_curr)
    => (float[B,3,56] prior_basis, float[B,3] means)
<int64[2] sides = {2, 3}, int64[1] batch = {0}>
{
    total = ReduceMean <keepdims = 0> (cost_map, sides)
    means = Identity (total)
    size = Shape <start = 0, end = 1> (x_curr)
    rest = Constant <value_ints = [1, 1]> ()
    wide = Concat <axis = 0> (size, rest)
    one = Unsqueeze (basis, batch)
    prior_basis = Expand (one, wide)
}
"""

MODULATE = """
<ir_version: 10, opset_import: ["": 20]>
modulate (float[K] times, float[B,3] means) => (float[B,K,3] modulation)
<int64[2] around = {0, 2}, int64[1] times_axis = {1}, float four = {4.0}, float three = {3.0}>
{
    cubed = Pow (times, three)
    speed = Mul (cubed, four)
    rows = Unsqueeze (speed, around)
    columns = Unsqueeze (means, times_axis)
    modulation = Mul (rows, columns)
}
"""

FIELD = """
<ir_version: 10, opset_import: ["": 20]>
field (float[B,N,8,7] x_t, float[B,N,8,7] prior_mean, float[B,3] modulation)
    => (float[B,N,8,7] dx_t)
<int64[2] inner = {1, 2}>
{
    twice = Concat <axis = 1> (modulation, modulation)
    lasting = Constant <value_ints = [0, 0, 0, 1]> ()
    carried = Pad (twice, lasting)
    speed = Unsqueeze (carried, inner)
    along = Mul (prior_mean, pull)
    dx_t = Add (along, speed)
}
"""


ROLES = {"encode": ENCODE, "modulate": MODULATE, "field": FIELD}


def write_graphs_of(folder: Path, *, heading: bool = False) -> dict[str, Any]:
    """Write the graphs; with a heading D = 3, S = 10, and the means move it and its derivatives."""
    texts, D, size = ROLES, 2, S
    if heading:
        wider = {"[B,6]": "[B,9]", "8,7]": "8,10]", "3,56]": "3,80]"}
        texts, D, size = {**ROLES, "field": FIELD.replace(TWICE, THRICE)}, 3, 10
        for narrow, wide in wider.items():
            texts = {role: text.replace(narrow, wide) for role, text in texts.items()}
    basis = np.zeros((R, T, size), np.float32)
    basis[0, :, :D] = basis[1, :, D : 2 * D] = basis[2, :, -1] = 0.1
    pull = np.repeat(PULL, [1, D - 1, 1, D - 1, 1, D - 1, 1])
    constants = {"encode": {"basis": basis.reshape(R, T * size)}, "field": {"pull": pull}}
    return write_graphs(folder, texts, constants)


def write_tiny_bundle(folder: Path) -> None:
    """Its graphs and its manifest."""
    write_manifest(
        folder,
        "tiny",
        version="1.2.3",
        request={
            "inputs": [
                tensor("cost_map", "float32", "B", "C", "H", "W"),
                tensor("x_curr", "float64", "B", 6, unit="m"),
            ]
        },
        conditioning={
            "kind": "cost_map",
            "channels": 3,
            "H": 16,
            "W": 16,
            "limits": {"horizon_s": 7.0, "v_max": 2.0, "a_max": 3.0, "robot_radius": 0.25},
            "ranges": {"robot_radius": [0.0, 5.0]},
        },
        graphs=write_graphs_of(folder),
        sampler={
            "kind": "ode",
            "method": "rk4",
            "schedule": [0.0, 0.5, 1.0],
            "prior": {"mean": "route_states", "basis": "prior_basis"},
        },
        finish={
            "kind": "spline",
            "smooth": True,
            "project": False,
            "safety_margin": 0.05,
            "guidance": 0.0,
            "steps": 2,
            "num_control_points": 12,
            "degree": 4,
        },
        time={"steps": T, "first_s": 0.0, "dt": 7.0 / (T - 1)},
        answer={
            "components": ["x", "y"],
            "arrays": ["velocities", "accelerations", "scores", "clearance", "safe"],
        },
    )


FREE_RANGES = {
    "robot_radius": [0.1, 0.6],
    "v_max": [0.2, 6.0],
    "a_max": [0.1, 8.0],
    "horizon_s": [1.0, 120.0],
}
