"""The cost is what its docstring says, its hand-written gradient equals finite differences to
their own precision, and descent does what it is for."""

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_trajectory.clearance import clearance_field, path_clearance
from anchorflow_trajectory.cost import CostWeights, MotionLimits, TrajectoryCost
from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.descent import descend
from anchorflow_trajectory.spline import spline_basis

LIMITS = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)
X_CURR = np.asarray([1.0, 3.2, 0.4, 0.0, 0.0, 0.0], np.float32)
X_GOAL = np.asarray([5.5, 3.1, 0.0, 0.0], np.float32)
BASIS = spline_basis(64, 8.0)

GAINS = ("safety", "energy", "smooth", "collision", "speed", "acceleration")
CORNERS = np.eye(3)
STYLES = (*CORNERS, np.array([0.4, 0.3, 0.3]), np.array([0.1, 0.7, 0.2]))


def fields(*, risky: bool = False) -> CostFields:
    """A post in the way and, if asked for, risky ground below it, more of it to the right."""
    occupied = np.zeros((64, 64), bool)
    occupied[30:34, 31:35] = True
    cost_map = np.zeros((3, 64, 64), np.float32)
    cost_map[0], cost_map[1] = occupied, 1.0
    if risky:
        cost_map[2] = np.linspace(1.0, 0.0, 64)[:, None] * np.linspace(0.6, 1.0, 64)
    return CostFields.of(cost_map, clearance_field(occupied, 0.1, 0.25), 0.1, np.zeros(2))


def cost(
    style: tuple[float, float, float] = (0.4, 0.3, 0.3), *, risky: bool = False
) -> TrajectoryCost:
    return TrajectoryCost(BASIS, fields(risky=risky), LIMITS, np.asarray(style, np.float32))


def disturbed(count: int, spread: float = 0.4) -> np.ndarray:
    rng = np.random.default_rng(3)
    control = np.repeat(BASIS.rest_curve(X_CURR, X_GOAL)[:, None], count, axis=1)
    free = control[..., BASIS.free]
    # Least at the ends, where the control points lie close and a shift is a jolt.
    free += rng.normal(0.0, spread, free.shape) * np.sin(np.linspace(0.0, np.pi, free.shape[-1]))
    return control.astype(np.float64)


def with_heading(control: np.ndarray) -> np.ndarray:
    """[2, M, K] with a third dimension in rad."""
    heading = np.random.default_rng(4).normal(0.0, 0.5, control[:1].shape)
    return np.concatenate([control, heading])


def in_double(
    style: np.ndarray, *, risky: bool = True, weights: CostWeights | None = None
) -> TrajectoryCost:
    """A cost whose arithmetic is float64 where its arguments are."""
    weights = weights or CostWeights()
    return TrajectoryCost(BASIS, fields(risky=risky), LIMITS, style, 0.08, weights)


def only(gain: str) -> CostWeights:
    """Of all terms that one."""
    return replace(CostWeights(), **{name: 0.0 for name in GAINS if name != gain})


def told(problem: TrajectoryCost, control: np.ndarray) -> dict[str, np.ndarray]:
    """The terms of J [M] as the module's docstring tells them, before they are weighed."""
    rows = (BASIS.position, BASIS.velocity, BASIS.acceleration, BASIS.jerk)
    p, v, a, jerk = (control @ matrix.T.astype(np.float64) for matrix in rows)
    clearance = problem.fields.clearance.sample(p[0], p[1])
    lack = np.maximum(1 - clearance / 0.6, 0)
    if problem.fields.soft is not None:
        lack = np.sqrt(lack**2 + problem.fields.soft.sample(p[0], p[1]))
    hard = np.maximum(problem.margin - clearance, 0)
    speed, push = (np.hypot(x[0], x[1]) for x in (v, a))
    terms = {
        "safety": lack**2,
        "energy": (v**2).sum(0) / LIMITS.v_max**2,
        "smooth": (jerk**2).sum(0) / 3.0**2,
        "collision": np.where(hard > 0.25, 0.25 * (2 * hard - 0.25), hard**2),
        "speed": np.maximum(speed - 0.95 * LIMITS.v_max, 0) ** 2,
        "acceleration": np.maximum(push - 0.95 * LIMITS.a_max, 0) ** 2,
    }
    return {name: term.mean(-1) for name, term in terms.items()}


@pytest.mark.parametrize("style", STYLES, ids=str)
@pytest.mark.parametrize("risky", [False, True])
def test_the_cost_is_what_the_docstring_says(style: np.ndarray, risky: bool) -> None:
    problem, control = in_double(style, risky=risky), with_heading(disturbed(6, spread=1.0))
    terms = told(problem, control)
    assert all((term > 0).any() for term in terms.values())
    w, cubed = problem.weights, style**3 / (style**3).sum()
    expected = sum(
        share * getattr(w, name) * terms[name]
        for share, name in zip((*cubed, 1, 1, 1), GAINS, strict=True)
    )
    np.testing.assert_allclose(problem.value(control), expected, rtol=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("risky", [False, True])
@pytest.mark.parametrize("gain", GAINS)
def test_each_terms_gradient_equals_finite_differences(gain: str, risky: bool, dim: int) -> None:
    """Term by term, because beside the hinges at 400 a style of 8 is not seen."""
    corner = CORNERS[GAINS.index(gain)] if gain in GAINS[:3] else CORNERS[0]
    control = disturbed(6, spread=1.0)
    control = with_heading(control) if dim == 3 else control
    assert_gradient(in_double(corner, risky=risky, weights=only(gain)), control)


@pytest.mark.parametrize("style", STYLES, ids=str)
def test_the_whole_gradient_equals_finite_differences(style: np.ndarray) -> None:
    assert_gradient(in_double(style), with_heading(disturbed(6, spread=1.0)))


def test_each_trajectory_may_have_its_own_style() -> None:
    control, styles = disturbed(5, spread=1.0), np.stack(STYLES)
    value, gradient = in_double(styles).value_and_gradient(control)
    for m, style in enumerate(STYLES):
        one, slope = in_double(style).value_and_gradient(control[:, m : m + 1])
        np.testing.assert_allclose(value[m : m + 1], one, rtol=1e-12)
        np.testing.assert_allclose(gradient[:, m : m + 1], slope, rtol=1e-9, atol=1e-12)


def assert_gradient(problem: TrajectoryCost, control: np.ndarray) -> None:
    """Central differences over 1e-6 m agree to 1e-7 of the largest slope, in every direction."""
    h, rng = 1e-6, np.random.default_rng(5)
    _, gradient = problem.value_and_gradient(control)
    assert np.abs(gradient).max() > 1e-3
    for _ in range(8):
        direction = rng.normal(size=control.shape)
        ahead, behind = (problem.value(control + s * h * direction) for s in (1, -1))
        slope = (gradient * direction).sum((0, 2))
        scale = np.abs(gradient).max() * np.abs(direction).max()
        np.testing.assert_allclose((ahead - behind) / (2 * h), slope, atol=1e-7 * scale, rtol=1e-6)


def test_descent_frees_anchors_and_keeps_the_ends_and_the_limits() -> None:
    problem, start = cost(), disturbed(32).astype(np.float32)
    control = descend(problem, start, steps=60, rate=0.3)
    assert (problem.value(control) < problem.value(start)).all()
    position, velocity, acceleration = BASIS.states(control)
    clearance = path_clearance(problem.fields.clearance, position, max_step=0.02)
    assert (clearance > 0).mean() > 0.9
    assert np.linalg.norm(velocity, axis=-1).max() <= 1.02 * LIMITS.v_max
    assert np.linalg.norm(acceleration, axis=-1).max() <= 1.03 * LIMITS.a_max
    np.testing.assert_allclose(position[:, 0], np.tile(X_CURR[:2], (32, 1)), atol=1e-5)
    np.testing.assert_allclose(position[:, -1], np.tile(X_GOAL[:2], (32, 1)), atol=1e-5)


def test_descent_leaves_a_heading_where_it_was() -> None:
    planar = disturbed(8).astype(np.float32)
    heading = np.random.default_rng(4).normal(0.0, 0.3, planar[:1].shape).astype(np.float32)
    control = descend(cost(), np.concatenate([planar, heading]), steps=20, rate=0.3)
    np.testing.assert_array_equal(control[2:], heading)
    # All three dimensions share a product, so sums may be rounded differently.
    np.testing.assert_allclose(control[:2], descend(cost(), planar, steps=20, rate=0.3), atol=1e-4)


def test_one_trajectory_never_touches_another() -> None:
    start = disturbed(8).astype(np.float32)
    together = descend(cost(), start, steps=20, rate=0.3)
    alone = descend(cost(), start[:, 3:4], steps=20, rate=0.3)
    np.testing.assert_allclose(together[:, 3:4], alone, atol=2e-5)


def test_each_style_is_visible() -> None:
    start = disturbed(32).astype(np.float32)

    def finished(style: tuple[float, float, float]) -> tuple[float, float, float]:
        problem = cost(style)
        control = descend(problem, start, steps=80, rate=0.3)
        position, _, _ = BASIS.states(control)
        clearance = path_clearance(problem.fields.clearance, position, max_step=0.02)
        length = np.linalg.norm(np.diff(position, axis=1), axis=-1).sum(1)
        jerk = np.linalg.norm(control.transpose(1, 0, 2) @ BASIS.jerk.T, axis=1).mean(1)
        return float(clearance.mean()), float(length.mean()), float(jerk.mean())

    safe, energetic, smooth = (finished(s) for s in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert safe[0] > 1.2 * energetic[0]
    assert energetic[1] < safe[1]
    assert smooth[2] < 0.9 * min(safe[2], energetic[2])


def test_risky_ground_is_avoided() -> None:
    start = disturbed(16).astype(np.float32)
    plain, risky = (
        BASIS.states(descend(cost((0.8, 0.1, 0.1), risky=r), start, steps=60, rate=0.3))[0]
        for r in (False, True)
    )
    assert risky[..., 1].mean() > plain[..., 1].mean() + 0.1
