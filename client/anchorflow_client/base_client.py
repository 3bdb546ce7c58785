"""What every client of a service can do, whatever carries its requests."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap, ModelCard
from anchorflow_client.errors import InvalidRequest

Client = TypeVar("Client", bound="BaseClient")


class BaseClient(ABC):
    """Asks a service for anchors.

    Every method raises a `RequestError` where the service refuses and a `TransportError` where no
    answer of the contract comes; see `anchorflow_client.errors`.
    """

    def plan(
        self,
        *,
        cost_map: CostMap | Mapping[str, Any] | ArrayLike,
        x_curr: ArrayLike,
        x_goal: ArrayLike,
        resolution: float | None = None,
        origin: ArrayLike | None = None,
        **optional: Any,
    ) -> AnchorBatch:
        """Anchors from a state to a goal.

        Args:
            cost_map: a CostMap, {"data", "resolution", "origin"}, or an array [H,W], [C,H,W] or
                [B,C,H,W] in [0, 1] beside `resolution` and `origin`.
            x_curr: [3D] or [B,3D] position, velocity, acceleration in m, m/s, m/s^2; D is the
                model's: 2 (x, y) or 3 (x, y, heading in rad, which runs on beyond ±π).
            x_goal: [2D] or [B,2D] position, velocity.
            resolution: m/cell, with an array.
            origin: [2] m, outer corner of cell (0, 0), with an array; None centres the map.
            **optional: further fields of `AnchorRequest`, such as num_samples, seed, budget_ms.

        Raises:
            InvalidRequest: before anything is sent, where a field breaks the contract.
        """
        grid = _cost_map(cost_map, resolution, origin)
        request = AnchorRequest.build(cost_map=grid, x_curr=x_curr, x_goal=x_goal, **optional)
        return self.plan_request(request)

    @abstractmethod
    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """The same for a request that was built before."""

    @abstractmethod
    def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served, the default first."""

    @abstractmethod
    def live(self) -> bool:
        """Whether a service answers; False where nobody listens."""

    @abstractmethod
    def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the connection."""

    def __enter__(self: Client) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def _cost_map(cost_map: Any, resolution: Any, origin: Any) -> CostMap | Mapping[str, Any]:
    if isinstance(cost_map, CostMap | Mapping):
        if resolution is not None or origin is not None:
            raise InvalidRequest("expected resolution and origin inside this map only", "cost_map")
        return cost_map
    data = np.asarray(cost_map)
    data = data[None] if data.ndim == 2 else data
    return {"data": data, "resolution": resolution, "origin": origin}
