"""The answer: N anchors a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.arrays import read_only
from anchorflow_client.contract.card import ModelId

ARRAY_DTYPES: dict[str, type[np.generic]] = {
    "trajectories": np.float32,
    "velocities": np.float32,
    "accelerations": np.float32,
    "scores": np.float32,
    "clearance": np.float32,
    "safe": np.bool_,
}
"""The arrays of an answer; all are read-only."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AnchorBatch:
    """Anchors in the map's frame. Where the request was batched, a B axis leads every array."""

    trajectories: NDArray[np.float32]
    """[N,T,D] m; the third of D = 3 is a heading in rad, its derivatives in rad/s and rad/s^2."""
    velocities: NDArray[np.float32]
    """[N,T,D] m/s."""
    accelerations: NDArray[np.float32]
    """[N,T,D] m/s^2."""
    scores: NDArray[np.float32]
    """[N], higher is better."""
    clearance: NDArray[np.float32]
    """[N] m beyond robot_radius, smallest along the path."""
    safe: NDArray[np.bool_]
    """[N], whether the path keeps robot_radius from every obstacle and stays on the map."""
    dt: float
    """s between two time steps."""
    seed: int
    model: ModelId
    timing_ms: Mapping[str, float]
    """queue, encode, sample, refine, total."""
    request_id: str | None = None

    def __post_init__(self) -> None:
        """Freeze the arrays.

        Raises:
            ValueError: the shapes do not belong together.
        """
        for name, dtype in ARRAY_DTYPES.items():
            array = read_only(np.asarray(getattr(self, name), dtype=dtype))
            object.__setattr__(self, name, array)
        self._check_shapes()

    def _check_shapes(self) -> None:
        shape = self.trajectories.shape
        if len(shape) not in (3, 4):
            raise ValueError(f"trajectories: expected [N,T,D] or [B,N,T,D], got {list(shape)}")
        for name in ARRAY_DTYPES:
            want = shape if name in ("trajectories", "velocities", "accelerations") else shape[:-2]
            came = getattr(self, name).shape
            if came != want:
                raise ValueError(f"{name}: expected shape {list(want)}, got {list(came)}")

    @property
    def batched(self) -> bool:
        """Whether a B axis leads the arrays."""
        return self.trajectories.ndim == 4

    @property
    def best(self) -> NDArray[np.intp] | np.intp:
        """Index of the best safe anchor by score, of the best at all where none is safe; [B]."""
        eligible = self.safe | ~self.safe.any(axis=-1, keepdims=True)
        return np.where(eligible, self.scores, -np.inf).argmax(axis=-1)

    @property
    def is_finite(self) -> bool:
        """Whether every number is finite, as all that is sent must be."""
        numbers = (getattr(self, name) for name in ARRAY_DTYPES)
        scalars = (self.dt, *self.timing_ms.values())
        return all(np.isfinite(values).all() for values in (*numbers, scalars))
