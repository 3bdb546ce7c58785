"""What moves on the map: people and vehicles as discs, by their tracks."""

# No `from __future__ import annotations`: the rows are read out of the annotations below.
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.checks import Interval, frozen, number, numbers, wrong_shape
from anchorflow_client.contract.ranges import (
    COORDINATE,
    FORECAST_DT,
    GROWTH,
    OBSTACLE_RADIUS,
    VELOCITY,
)
from anchorflow_client.contract.rows import Array, Group, Number, rows_of
from anchorflow_client.errors import InvalidRequest

MAX_OBSTACLES = 128
MAX_FORECAST_STEPS = 256
LATER = Interval(0.0, 600.0, "s")


@dataclass(frozen=True, eq=False)
class Obstacles:
    """M discs that move, seen at time 0, the moment of `x_curr`; all scenes of a batch share them.

    They keep their velocity unless there is a forecast, which goes on with the velocity of its last
    leg. Positions are in the map's frame and may lie off the map.
    """

    position: Annotated[
        NDArray[np.float64],
        Array(
            "Centres at the moment of x_curr, on the map or off it.",
            "[M,2]",
            ((0, MAX_OBSTACLES), (2, 2)),
            COORDINATE,
            unit="m",
            tensor="obstacle_position",
            required=True,
        ),
    ]
    velocity: Annotated[
        NDArray[np.float64] | None,
        Array(
            "Velocities; required without a forecast, not used with one.",
            "[M,2]",
            ((0, MAX_OBSTACLES), (2, 2)),
            VELOCITY,
            unit="m/s",
            tensor="obstacle_velocity",
        ),
    ]
    radius: Annotated[
        NDArray[np.float64],
        Array(
            "Radii at that moment.",
            "[M]",
            ((0, MAX_OBSTACLES),),
            OBSTACLE_RADIUS,
            unit="m",
            tensor="obstacle_radius",
            required=True,
        ),
    ]
    forecast: Annotated[
        NDArray[np.float64] | None,
        Array(
            "Centres after forecast_dt, 2 forecast_dt and so on, joined by straight lines; they go "
            "on as in the last of these.",
            "[M,K,2]",
            ((0, MAX_OBSTACLES), (1, MAX_FORECAST_STEPS), (2, 2)),
            COORDINATE,
            unit="m",
            tensor="obstacle_forecast",
        ),
    ] = None
    forecast_dt: Annotated[
        float | None,
        Number("Time between two places of the forecast; required with one.", FORECAST_DT),
    ] = None
    growth: Annotated[
        float,
        Number("By how much every radius grows in a second.", GROWTH, default=0.0),
    ] = 0.0

    @classmethod
    def from_fields(cls, value: Any) -> "Obstacles":
        """Check the JSON object; one without arrays tells that nothing moves now."""
        value = vars(value) if isinstance(value, Obstacles) else value
        if isinstance(value, Mapping) and not any(
            value.get(name) is not None for name in _ARRAY_READERS
        ):
            value = {**value, "position": [], "velocity": [], "radius": [], "forecast_dt": None}
        asked: dict[str, Any] = {"velocity": None}
        asked |= OBSTACLES.read(value, "obstacles", **_ARRAY_READERS)
        size = len(asked["position"])
        for name in _ARRAY_READERS:
            array = asked.get(name)
            if array is not None and (came := len(array)) != size:
                what = f"expected M = {size} as in obstacles.position, got {came}"
                raise InvalidRequest(what, f"obstacles.{name}")
        _check_motion(asked)
        if not size:  # one form of it, however it was told
            growth = asked.get("growth", 0.0)
            return cls(asked["position"], asked["position"], asked["radius"], growth=growth)
        return cls(**asked)

    def later(self, seconds: float) -> "Obstacles":
        """Return them as they will be after `seconds`, with time 0 at that moment.

        A forecast keeps K and its dt: it is interpolated linearly and goes on beyond its end.

        Raises:
            InvalidRequest: names `seconds` if it is not from 0 to 600.
        """
        seconds = number(seconds, "seconds", LATER)
        grown = replace(self, radius=frozen(self.radius + self.growth * seconds))
        if self.forecast is None:
            return replace(grown, position=frozen(self.places(seconds)[:, 0]))
        assert self.forecast_dt is not None
        moved = self.places(seconds + self.forecast_dt * np.arange(1 + self.forecast.shape[1]))
        return replace(grown, position=frozen(moved[:, 0]), forecast=frozen(moved[:, 1:]))

    def places(self, times: ArrayLike) -> NDArray[np.float64]:
        """Return the centres [M,K,2] in m at times [K] in s from 0 on; K = 1 for one number."""
        at = np.atleast_1d(np.asarray(times, np.float64))
        if self.forecast is None:
            assert self.velocity is not None
            return self.position[:, None] + at[:, None] * self.velocity[:, None]
        assert self.forecast_dt is not None
        knots = np.concatenate([self.position[:, None], self.forecast], axis=1)
        at = at / self.forecast_dt
        leg = np.minimum(at.astype(int), knots.shape[1] - 2)
        before, after = knots[:, leg], knots[:, leg + 1]
        return before + (at - leg)[:, None] * (after - before)


def _read_array(value: Any, path: str, row: Array) -> NDArray[np.float64]:
    """Read an array whose first axis is M; an empty list is one of M = 0."""
    array = numbers(value, path, row.interval, row.shape)
    if array.shape == (0,):
        array = array.reshape(0, *(least for least, _ in row.sizes[1:]))
    fits = array.ndim == len(row.sizes) and all(
        least <= size <= most for size, (least, most) in zip(array.shape, row.sizes, strict=True)
    )
    if not fits:
        axes = f"{row.shape}, M from 0 to {MAX_OBSTACLES}"
        if "K" in axes:
            axes += f" and K from 1 to {MAX_FORECAST_STEPS}"
        raise wrong_shape(path, axes, array)
    return frozen(array)


def _check_motion(asked: Mapping[str, Any]) -> None:
    """Refuse obstacles of an unknown motion, and a forecast without its times."""
    if "forecast" in asked:
        if "forecast_dt" not in asked:
            raise InvalidRequest("this field is required with a forecast", "obstacles.forecast_dt")
        return
    if "forecast_dt" in asked:
        came = f"expected none without a forecast, got {asked['forecast_dt']:g}"
        raise InvalidRequest(came, "obstacles.forecast_dt")
    if asked["velocity"] is None:
        message = "this field is required without a forecast, as no velocity is guessed"
        raise InvalidRequest(message, "obstacles.velocity")


OBSTACLES = Group(
    "What moves: M discs from the moment of x_curr on, the same in all scenes of a batch; "
    "clearance and safe count them at the times at which an anchor is near them.",
    rows_of(Obstacles),
)
_ARRAY_READERS: Mapping[str, Callable[[Any, str], NDArray[np.float64]]] = {
    name: partial(_read_array, row=row)
    for name, row in OBSTACLES.fields.items()
    if isinstance(row, Array)
}
