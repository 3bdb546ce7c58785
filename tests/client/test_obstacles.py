"""What moves: its fields as a request reads them, and where it is at a later moment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorRequest, InvalidRequest, Obstacles

PLACE = {"position": [[1.0, 2.0], [3.0, 4.0]], "radius": [0.3, 0.1]}
CONSTANT = PLACE | {"velocity": [[1.0, 0.0], [0.0, -2.0]]}
TURN = [[[1.0, 3.0], [2.0, 3.0]], [[3.0, 4.0], [3.0, 4.0]]]
"""The first goes up and then right, the second stands."""
TOLD = PLACE | {"forecast": TURN, "forecast_dt": 0.5}


@pytest.mark.parametrize("given", [CONSTANT, TOLD, TOLD | {"velocity": CONSTANT["velocity"]}])
def test_the_scenes_of_a_batch_share_what_moves(
    fields: dict[str, Any], given: dict[str, Any]
) -> None:
    fields["x_curr"] = [fields["x_curr"]] * 3
    read: Any = given
    for _ in range(2):  # from its fields, and as it was read
        read = AnchorRequest.from_fields(fields | {"obstacles": read}).obstacles
        for name in ("position", "velocity", "radius", "forecast"):
            array = getattr(read, name)
            if name not in given:
                assert array is None
                continue
            np.testing.assert_array_equal(array, given[name])
            assert array.dtype == np.float64
            assert not array.flags.writeable
        assert (read.forecast_dt, read.growth) == (given.get("forecast_dt"), 0.0)


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        ({"forecast_dt": None}, "forecast_dt", "required with a forecast"),
        ({"forecast": TURN[:1]}, "forecast", "expected M = 2 as in obstacles.position, got 1"),
        ({"forecast": [[], []]}, "forecast", r"K from 1 to 256, got \[2, 0\]"),
        ({"forecast": np.zeros((2, 257, 2))}, "forecast", r"got \[2, 257, 2\]"),
        ({"forecast_dt": 0}, "forecast_dt", r"in \[0.001, 600\] s, got 0"),
    ],
)
def test_a_forecast_that_cannot_be_followed_is_refused(
    fields: dict[str, Any], change: dict[str, Any], field: str, words: str
) -> None:
    with pytest.raises(InvalidRequest, match=words) as caught:
        AnchorRequest.from_fields(fields | {"obstacles": TOLD | change})
    assert caught.value.field == f"obstacles.{field}"


@pytest.mark.parametrize(
    ("given", "seconds", "position", "forecast"),
    [
        (CONSTANT, 0.25, [[1.25, 2.0], [3.0, 3.5]], None),
        (TOLD, 0.5, [[1.0, 3.0], [3.0, 4.0]], [[[2.0, 3.0], [3.0, 3.0]], [[3.0, 4.0]] * 2]),
        (TOLD, 0.25, [[1.0, 2.5], [3.0, 4.0]], [[[1.5, 3.0], [2.5, 3.0]], [[3.0, 4.0]] * 2]),
        (TOLD, 1.5, [[3.0, 3.0], [3.0, 4.0]], [[[4.0, 3.0], [5.0, 3.0]], [[3.0, 4.0]] * 2]),
    ],
)
def test_later_they_are_further_along_their_tracks_and_wider(
    given: dict[str, Any], seconds: float, position: Any, forecast: Any
) -> None:
    later = Obstacles.from_fields(given | {"growth": 0.2}).later(seconds)

    np.testing.assert_allclose(later.position, position)
    np.testing.assert_allclose(later.radius, np.array([0.3, 0.1]) + 0.2 * seconds)
    assert (later.forecast is None) == (forecast is None)
    if later.forecast is not None:
        np.testing.assert_allclose(later.forecast, forecast)
    assert later.growth == 0.2
    assert later.forecast_dt == given.get("forecast_dt")
