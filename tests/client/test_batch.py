"""The answer: frozen, of one shape, and able to name its best anchor."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from staged_planner import made_batch

from anchorflow_client import AnchorBatch, InvalidRequest, ModelId
from anchorflow_client.contract.batch import NEAR

MODEL = ModelId("lines", "1", "ab")


def batch(trajectories: Any = None, **fields: Any) -> AnchorBatch:
    """Return three anchors, the second of them the best and unsafe."""
    three = {"scores": [1.0, 3.0, 2.0], "clearance": [0.1, -0.2, 0.3], "safe": [True, False, True]}
    return made_batch(trajectories, **three | {"seed": 7} | fields)


def test_the_best_is_the_best_of_the_safe_or_of_all_if_none_is() -> None:
    assert batch().best == 2
    assert batch(safe=np.zeros(3, bool)).best == 1


def test_each_scene_has_its_best() -> None:
    scores, safe = [[1.0, 3.0, 2.0]] * 2, [[True, False, True], [False] * 3]
    anchors = batch(np.zeros((2, 3, 4, 2)), scores=scores, clearance=scores, safe=safe)

    assert anchors.batched
    np.testing.assert_array_equal(anchors.best, [2, 1])


RANKED = {
    "scores": [5.0, 9.0, 4.0, 8.0, 3.0, 9.5],
    "safe": [True, False, True, True, True, False],
    "routes": [0, 2, 0, 0, 1, 0],
}


@pytest.mark.parametrize(
    ("k", "per_route", "indices"),
    [
        (1, False, [3]),
        (6, False, [3, 0, 2, 4, 5, 1]),
        (3, True, [3, 4, 0]),
        (9, True, [3, 4, 0, 2, 1, 5]),
    ],
)
@pytest.mark.parametrize("scenes", [(), (2,)])
def test_the_top_k_are_safe_ones_first_and_of_different_routes_if_asked(
    k: int, per_route: bool, indices: list[int], scenes: tuple[int, ...]
) -> None:
    ranked = {name: np.broadcast_to(values, (*scenes, 6)) for name, values in RANKED.items()}
    anchors = batch(np.zeros((*scenes, 6, 4, 2)), clearance=ranked["scores"], **ranked)

    top = anchors.top_k(k, per_route=per_route)

    np.testing.assert_array_equal(top, np.broadcast_to(indices, (*scenes, len(indices))))


def test_an_answer_of_an_older_service_has_no_routes() -> None:
    assert batch().routes is None
    assert batch().top_k(2).tolist() == [2, 0]
    with pytest.raises(LookupError, match="routes: lines gives none"):
        batch().top_k(2, per_route=True)
    with pytest.raises(InvalidRequest, match="k: expected an integer from 1"):
        batch().top_k(0)


@pytest.mark.parametrize(
    ("field", "shape"), [("velocities", (3, 4, 3)), ("scores", (2,)), ("trajectories", (3, 4))]
)
def test_shapes_must_belong_together(field: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected (shape )?\["):
        batch(**{field: np.zeros(shape)})


@pytest.mark.parametrize(
    "fields", [{"clearance": [0, np.inf, 0]}, {"dt": np.nan}, {"dt": [0.1, np.inf, 0.1]}]
)
def test_a_number_that_is_not_finite_is_seen(fields: dict[str, Any]) -> None:
    assert batch().is_finite
    assert not batch(**fields).is_finite


def scenes_of(paths: np.ndarray, dt: Any) -> AnchorBatch:
    return AnchorBatch(arrays={"trajectories": paths}, dt=dt, seed=1, model=MODEL, timing_ms={})


@pytest.mark.parametrize("scenes", [(), (2,)])
def test_durations_are_told_for_either_form_of_dt(scenes: tuple[int, ...]) -> None:
    paths = np.zeros((*scenes, 3, 5, 2))
    own = np.broadcast_to([0.5, 1.0, 2.0], (*scenes, 3))

    alike, each = scenes_of(paths, 0.5), scenes_of(paths, own)

    assert (alike.dt, type(alike.dt)) == (0.5, float)
    np.testing.assert_array_equal(alike.durations, np.full((*scenes, 3), 2.0))
    np.testing.assert_array_equal(each.durations, np.broadcast_to([2.0, 4.0, 8.0], (*scenes, 3)))
    assert each.durations.dtype == np.float64


def test_its_time_steps_are_float64_and_cannot_be_written() -> None:
    dt = batch(dt=np.array([1, 2, 3], np.float32)).dt

    assert isinstance(dt, np.ndarray)
    assert dt.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        dt[0] = 1.0


@pytest.mark.parametrize(
    ("dt", "words"),
    [
        ([0.1, 0.2], r"dt: expected a number or shape \[3\], got \[2\]"),
        ([[0.1, 0.2, 0.3]], r"dt: expected a number or shape \[3\], got \[1, 3\]"),
        (0.0, "dt: expected s above 0, got 0"),
        ([0.1, -0.2, 0.3], r"dt: expected s above 0, got -0\.2"),
    ],
)
def test_a_wrong_time_step_is_refused(dt: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        batch(dt=np.array(dt))


def test_only_trajectories_have_to_be_there() -> None:
    paths = np.zeros((3, 4, 2))
    bare = AnchorBatch(
        arrays={"trajectories": paths}, dt=0.5, first_s=0.5, seed=1, model=MODEL, timing_ms={}
    )

    assert bare.best == 0
    with pytest.raises(LookupError, match="velocities: lines gives none; it gives trajectories"):
        _ = bare.velocities
    with pytest.raises(ValueError, match="trajectories: expected"):
        AnchorBatch(arrays={"scores": np.zeros(3)}, dt=0.5, seed=1, model=MODEL, timing_ms={})


@pytest.mark.parametrize(("reach", "dtype"), [(NEAR, np.float32), (2 * NEAR, np.float64)])
def test_far_from_zero_trajectories_keep_their_digits(reach: float, dtype: type) -> None:
    paths = np.full((3, 4, 2), reach + 0.0)

    assert batch(trajectories=paths).trajectories.dtype == dtype


@pytest.mark.parametrize("again", [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
@pytest.mark.parametrize("dt", [0.1, [0.1, 0.2, 0.3]])
def test_a_copy_in_another_process_is_as_frozen_as_the_first(again: Any, dt: Any) -> None:
    first = batch(dt=dt, request_id="r1")
    second = again(first)

    assert second.arrays.keys() == first.arrays.keys()
    for name, array in first.arrays.items():
        np.testing.assert_array_equal(second.arrays[name], array)
        assert not second.arrays[name].flags.writeable
        assert not np.shares_memory(second.arrays[name], array)
    with pytest.raises(TypeError):
        second.arrays["scores"] = first.scores
    np.testing.assert_array_equal(second.dt, first.dt)
    assert not np.asarray(second.dt).flags.writeable or np.ndim(dt) == 0
    assert (second.seed, second.model, second.request_id) == (7, MODEL, "r1")


def test_told_anew_its_anchors_are_the_same() -> None:
    first = batch(request_id="first")
    second = first.told(timing_ms={"total": 2.0}, request_id="second")

    assert (first.request_id, second.request_id) == ("first", "second")
    assert (second.timing_ms, second.arrays) == ({"total": 2.0}, first.arrays)
    assert first.timing_ms != second.timing_ms


def ways() -> AnchorBatch:
    """Straight on, to the left, and twice to the right, the second worth more."""
    ahead = np.linspace(0.0, 20.0, 4)
    paths = np.stack([np.stack([ahead, slope * ahead], -1) for slope in (0.0, 0.5, -0.5, -0.45)])
    return made_batch(paths, scores=[0.9, 0.8, 0.3, 0.4])


def test_along_a_route_the_best_is_the_best_that_ends_there() -> None:
    right = [[0.0, 0.0], [10.0, -5.0], [10.0, -5.0], [40.0, -20.0]]
    assert ways().best == 0
    assert ways().best_along(right) == 3
    assert ways().best_along(right, within=0.5) == 2  # the other ends 0.9 m beside it
    assert ways().best_along([[0.0, 0.0], [40.0, 0.0]]) == 0
    assert ways().best_along([[0.0, 0.0], [40.0, 0.0]], within=11.0) == 0


def test_who_comes_back_to_the_route_follows_it() -> None:
    """An anchor that returns from 3 m beside the route follows it; one that waits does not."""
    ahead = np.linspace(0.0, 15.0, 4)
    paths = np.stack([np.stack([ahead, 3.0 - ahead / 5], -1), np.stack([0 * ahead, 0 * ahead], -1)])
    beside = made_batch(paths, scores=[0.5, 0.4])
    assert beside.best_along([[0.0, 0.0], [40.0, 0.0]]) == 0


@pytest.mark.parametrize(("standing", "chosen"), [(0.4, 0), (0.6, 1)])
def test_where_none_follows_the_route_the_best_of_all_is_taken(
    standing: float, chosen: int
) -> None:
    """Who stands follows no route, however near to it: it is taken where it is the best."""
    ahead = np.linspace(0.0, 15.0, 4)
    paths = np.stack([np.stack([ahead, ahead], -1), np.stack([0.05 * ahead, 0 * ahead], -1)])
    lost = made_batch(paths, scores=[0.5, standing])
    assert lost.best_along([[0.0, -1.0], [40.0, -1.0]]) == chosen
    assert ways().best_along([[0.0, 90.0], [40.0, 90.0]]) == ways().best


def test_along_a_route_what_is_safe_comes_first() -> None:
    told = made_batch(**{**ways().arrays, "safe": [True, True, True, False]})
    assert told.best_along([[0.0, 0.0], [40.0, -20.0]]) == 2


@pytest.mark.parametrize(
    ("route", "message"),
    [
        ([[0.0, 0.0]], r"route: expected two or more finite points \[V, 2\], got shape \[1, 2\]"),
        ([0.0, 1.0], r"got shape \[2\]"),
        ([[0.0, 0.0], [np.nan, 1.0]], "got some that are not"),
        ("north", "route: expected an array of numbers"),
    ],
)
def test_a_route_that_is_none_is_refused(route: Any, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        batch().best_along(route)


@pytest.mark.parametrize("within", [-1.0, np.nan, np.inf, "2 m", None])
def test_along_a_route_within_is_a_distance(within: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"within: expected a number in \[0, inf\) m, got "):
        ways().best_along([[0.0, 0.0], [40.0, 0.0]], within=within)


def test_what_ends_beyond_a_routes_end_is_beside_it() -> None:
    short, long = [[0.0, 0.0], [10.0, -5.0]], [[0.0, 0.0], [40.0, -20.0]]
    assert (ways().best_along(short), ways().best_along(long)) == (ways().best, 3)


def test_of_several_scenes_there_is_no_one_route() -> None:
    several = made_batch(np.zeros((1, 3, 4, 2)))
    with pytest.raises(ValueError, match="best_along: expected the answer of one scene"):
        several.best_along([[0.0, 0.0], [1.0, 0.0]])


def test_it_is_shown_by_the_figures_that_matter() -> None:
    anchors = batch(routes=[0, 1, 0], timing_ms={"total": 12.4})
    shown = "3 anchors of 4 steps, 2 safe, 2 routes, 0.3 s, planned in 12 ms; lines 1, seed 7"
    assert repr(anchors) == f"<AnchorBatch: {shown}>"
    twice = {name: [[0.0] * 3] * 2 for name in ("scores", "clearance", "safe")}
    assert "2 scenes of 3 anchors" in repr(batch(np.zeros((2, 3, 4, 2)), **twice))
