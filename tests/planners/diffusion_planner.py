"""A planner of the kind `truncated_diffusion`, small enough to be worked out by hand.

encode    speed = ego_status[0]; anchor a: x = 0.1 (a + 1) k, y = 0.1 (a - 1) k, k = 1 … 8
denoise   x_0 = 0.9 x_t + 0.001 t;  trajectories = (speed x_0, 0.1 t)
coarse    candidate = (1 + 0.1 diversity[0]) trajectory;  score = -(y of its end - 1)²
fine      score = the candidate's x at its end, which coarse gives as a feature
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from written_graphs import tensor, write_graphs, write_manifest

from anchorflow_trajectory.ode.ddim import CLEAN, NoiseLevels, ddim_step, noised

A, GROUPS, VARIANTS, KEEP, T = 3, 4, 2, 6, 8
START, SCHEDULES, STEPS = 8, ((8,), (10, 0), (15, 10, 5, 0)), 2
LEVELS = NoiseLevels()

ENCODE = """
<ir_version: 10, opset_import: ["": 20]>
encode (float[B,4] ego_status)
    => (float[B,1] speed, float[B,3,8,2] anchors, float[B,1,2,2] bev_semantics)
<int64[1] first = {0}, int64[1] second = {1}, int64[1] one = {1},
 int64[4] four = {1, 1, 2, 2}, int64[2] inner = {2, 3}>
{
    speed = Slice (ego_status, first, second, one)
    flat = Mul (speed, nothing)
    wide = Unsqueeze (flat, inner)
    anchors = Add (fan, wide)
    cell = Unsqueeze (speed, inner)
    bev_semantics = Tile (cell, four)
}
"""

DENOISE = """
<ir_version: 10, opset_import: ["": 20]>
denoise (float[B,N,8,2] x_t, float[B] t, float[B,1] speed)
    => (float[B,N,8,2] x_0, float[B,N,8,3] trajectories)
<float most = {0.9}, float little = {0.001}, float tenth = {0.1}, int64[3] deep = {1, 2, 3},
 int64[2] inner = {2, 3}, int64[1] three = {3}, int64[1] zero = {0}, int64[1] one = {1}>
{
    level = Unsqueeze (t, deep)
    kept = Mul (x_t, most)
    shift = Mul (level, little)
    x_0 = Add (kept, shift)
    fast = Unsqueeze (speed, inner)
    points = Mul (x_0, fast)
    lead = Slice (x_0, zero, one, three)
    flat = Sub (lead, lead)
    turn = Mul (level, tenth)
    heading = Add (flat, turn)
    trajectories = Concat <axis = 3> (points, heading)
}
"""

COARSE = """
<ir_version: 10, opset_import: ["": 20]>
coarse (float[B,N,8,3] trajectories, float[B,N,V,2] diversity)
    => (float[B,M,8,3] candidates, float[B,M] features, float[B,M] coarse_scores)
<float tenth = {0.1}, float one = {1.0}, int64[1] two = {2}, int64[1] last = {7},
 int64[1] eighth = {8}, int64[1] three = {3}, int64[4] rows = {0, -1, 8, 3}, int64[1] zero = {0},
 int64[1] unit = {1}, int64[1] four = {4}, int64[2] inner = {2, 3}>
{
    copies = Unsqueeze (trajectories, two)
    chance = Slice (diversity, zero, unit, three)
    small = Mul (chance, tenth)
    factor = Add (small, one)
    factors = Unsqueeze (factor, four)
    varied = Mul (copies, factors)
    candidates = Reshape (varied, rows)
    ends = Slice (candidates, last, eighth, two)
    x = Slice (ends, zero, unit, three)
    y = Slice (ends, unit, two, three)
    features = Squeeze (x, inner)
    aside = Squeeze (y, inner)
    away = Sub (aside, one)
    square = Mul (away, away)
    coarse_scores = Neg (square)
}
"""

FINE = """
<ir_version: 10, opset_import: ["": 20]>
fine (float[B,M,8,3] candidates, float[B,M] features)
    => (float[B,M] scores, float[B,M,5] sub_scores)
<int64[1] two = {2}, int64[3] five = {1, 1, 5}, int64[1] last = {7}, int64[1] eighth = {8},
 int64[1] zero = {0}, int64[1] unit = {1}, int64[1] three = {3}, int64[2] inner = {2, 3}>
{
    ends = Slice (candidates, last, eighth, two)
    x = Slice (ends, zero, unit, three)
    own = Squeeze (x, inner)
    both = Add (own, features)
    gap = Sub (both, own)
    scores = Identity (gap)
    wide = Unsqueeze (scores, two)
    sub_scores = Tile (wide, five)
}
"""
ROLES = {"encode": ENCODE, "denoise": DENOISE, "coarse": COARSE, "fine": FINE}


def fan() -> np.ndarray:
    """The anchors [A, T, 2] in the diffusion's units."""
    k, a = np.arange(1, T + 1), np.arange(A)[:, None]
    return 0.1 * np.stack([(a + 1) * k, (a - 1) * k], -1).astype(np.float32)


def expected(speed: float, *, seed: int, steps: int = STEPS) -> dict[str, np.ndarray]:
    """Return the answer's arrays for all that are scored finely: the best first."""
    generator = np.random.Generator(np.random.PCG64(seed))
    start = generator.standard_normal((A * GROUPS, T, 2), dtype=np.float32)
    diversity = generator.standard_normal((A * GROUPS, VARIANTS, 2), dtype=np.float32)
    diversity[:, 0] = 0
    signal, levels = LEVELS.signal, SCHEDULES[[len(s) for s in SCHEDULES].index(steps)]
    x = noised(np.tile(fan(), (GROUPS, 1, 1)), start, float(signal[START]))
    poses = np.empty((A * GROUPS, T, 3))
    for level, after in zip(levels, (*levels[1:], None), strict=True):
        x_0 = 0.9 * x + 0.001 * level
        poses = np.concatenate([speed * x_0, np.full_like(x_0[..., :1], 0.1 * level)], -1)
        following = CLEAN if after is None else float(signal[after])
        x = ddim_step(x, x_0, float(signal[level]), following=following)
    candidates = poses[:, None] * (1 + 0.1 * diversity[..., :1])[..., None]
    candidates = candidates.reshape(-1, T, 3)
    coarse = -((candidates[:, -1, 1] - 1) ** 2)
    kept = np.argsort(-coarse, kind="stable")[:KEEP]
    best = kept[np.argsort(-candidates[kept, -1, 0], kind="stable")]
    return {
        "trajectories": candidates[best],
        "scores": candidates[best, -1, 0],
        "coarse_scores": coarse[best],
        "sub_scores": np.repeat(candidates[best, -1:, 0], 5, axis=1),
    }


def write_diffusion_bundle(folder: Path) -> Path:
    """The bundle, in a folder that is there."""
    constants = {"encode": {"fan": fan()[None], "nothing": np.zeros((1, 1), np.float32)}}
    extras = [
        tensor("coarse_scores", "float32", "B", "N"),
        tensor("sub_scores", "float32", "B", "N", 5),
        tensor("bev_semantics", "float32", "B", 1, 2, 2),
    ]
    return write_manifest(
        folder,
        "tiny-diffusion",
        request={"inputs": [tensor("ego_status", "float32", "B", 4, range=[-60.0, 60.0])]},
        sampler={
            "kind": "truncated_diffusion",
            "anchors": A,
            "groups": GROUPS,
            "variants": VARIANTS,
            "keep": KEEP,
            "noise": {"levels": LEVELS.levels, "first": LEVELS.first, "last": LEVELS.last},
            "start": START,
            "schedules": SCHEDULES,
            "steps": STEPS,
        },
        answer={"components": ["x", "y", "heading"], "arrays": ["scores"], "extras": extras},
        graphs=write_graphs(folder, ROLES, constants),
    )
