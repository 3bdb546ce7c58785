"""How far points lie from a route."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.checks import as_array
from anchorflow_client.errors import InvalidRequest

SHORTEST = 1e-9  # m², a segment's length squared below which it is a point


def beside_route(points: NDArray[np.floating], route: ArrayLike) -> NDArray[np.float64]:
    """[...] m from points [..., 2] to the nearest place of a polyline [V, 2].

    Raises:
        InvalidRequest: the route is none of two or more finite points; names `route`.
    """
    line = polyline(route)
    start, along = line[:-1], np.diff(line, axis=0)
    length = np.maximum((along**2).sum(-1), SHORTEST)
    offset = np.asarray(points, np.float64)[..., None, :] - start
    share = np.clip((offset * along).sum(-1) / length, 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * along, axis=-1).min(-1)


def polyline(route: ArrayLike) -> NDArray[np.float64]:
    """A route [V, 2].

    Raises:
        InvalidRequest: it is none of two or more finite points; names `route`.
    """
    line = as_array(route, "route", np.float64)
    if line.ndim != 2 or line.shape[0] < 2 or line.shape[1] != 2 or not np.isfinite(line).all():
        what = "expected two or more finite points [V, 2]"
        came = f"shape {list(line.shape)}" if np.isfinite(line).all() else "some that are not"
        raise InvalidRequest(f"{what}, got {came}", "route")
    return line
