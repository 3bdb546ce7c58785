"""The interface that every client implements, blocking or async, and the keywords of `plan`."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine, Mapping
from functools import wraps
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap, ModelCard
from anchorflow_client.contract.fields import RequestOptions
from anchorflow_client.contract.rows import rows_of
from anchorflow_client.errors import InvalidRequest

if TYPE_CHECKING:
    from typing_extensions import Unpack

Answer = TypeVar("Answer")
Method = TypeVar("Method", bound=Callable[..., Any])
Client = TypeVar("Client", bound="BaseClient")
AsyncClient = TypeVar("AsyncClient", bound="BaseAsyncClient")


def spelled_out(kind: type) -> Callable[[Method], Method]:
    """Return a decorator for a method whose `**options: Unpack[kind]` are rows of the table.

    Type checkers and editors complete such keywords. The decorator adds them to the signature and
    to the docstring, for `help` and notebooks, and raises `TypeError` for any other.
    """
    rows = rows_of(kind)
    keywords = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=kind.__annotations__[name].__origin__,
        )
        for name in rows
    ]

    def spell(method: Method) -> Method:
        signature = inspect.signature(method)
        own = [each for each in signature.parameters.values() if each.kind is not each.VAR_KEYWORD]
        known = {each.name for each in (*own, *keywords)}

        @wraps(method)
        def checked(self: Any, **given: Any) -> Any:
            for name in given:
                if name not in known:
                    raise TypeError(f"{method.__name__}() got an unexpected keyword {name!r}")
            return method(self, **given)

        told = [f"            {name}: {row.meaning}" for name, row in rows.items()]
        checked.__doc__ = (method.__doc__ or "").replace("            **options:", "\n".join(told))
        vars(checked)["__signature__"] = signature.replace(parameters=[*own, *keywords])
        return cast(Method, checked)

    return spell


class PlanKeywords(ABC, Generic[Answer]):
    """Declares `plan`; its `Answer` is a batch, or for an async client a batch to be awaited."""

    @spelled_out(RequestOptions)
    def plan(
        self,
        *,
        cost_map: CostMap | Mapping[str, Any] | ArrayLike | None = None,
        x_curr: ArrayLike | None = None,
        x_goal: ArrayLike | None = None,
        resolution: float | None = None,
        origin: ArrayLike | None = None,
        channel_weights: ArrayLike | None = None,
        **options: Unpack[RequestOptions],
    ) -> Answer:
        """Plan anchors from a state to a goal on a map, or for the inputs that the card lists.

        None leaves a field to the service or the card. Ranges, units and defaults of all fields
        are in the reference.

        Args:
            cost_map: a CostMap, {"data", "resolution", "origin", "channel_weights"}, or an array
                [H,W], [C,H,W] or [B,C,H,W] in [0, 1] beside `resolution` and `origin`.
            x_curr: [3D] or [B,3D] position in m, velocity within ±100 m/s, acceleration within
                ±100 m/s^2; D is the model's: 2 (x, y) or 3 (x, y, heading in rad, which runs on
                beyond ±π).
            x_goal: [2D] or [B,2D] position, velocity.
            resolution: m/cell, with an array.
            origin: [2] m, outer corner of cell (0, 0), with an array; None centres the map.
            channel_weights: [C-1] factors of the soft costs, with an array; None: 1 each.
            **options:

        Raises:
            InvalidRequest: before anything is sent, if a field breaks the contract.
        """
        return self._plan_built(
            lambda: AnchorRequest.build(
                cost_map=map_fields(cost_map, resolution, origin, channel_weights),
                x_curr=x_curr,
                x_goal=x_goal,
                **options,
            )
        )

    @abstractmethod
    def _plan_built(self, build: Callable[[], AnchorRequest]) -> Answer:
        """Plan the request that `build` returns, or raise its refusal once it is awaited."""


def map_fields(
    cost_map: CostMap | Mapping[str, Any] | ArrayLike | None,
    resolution: float | None,
    origin: ArrayLike | None,
    channel_weights: ArrayLike | None = None,
) -> CostMap | Mapping[str, Any] | None:
    """Convert a map of `plan` to that of `AnchorRequest`, uncopied. Raises `InvalidRequest`."""
    beside = {"resolution": resolution, "origin": origin}
    if channel_weights is not None:
        beside["channel_weights"] = channel_weights
    if cost_map is None or isinstance(cost_map, CostMap | Mapping):
        for name, value in beside.items():
            if value is not None:
                raise InvalidRequest(f"expected {name} inside this map only", "cost_map")
        return cost_map
    try:
        data = np.asarray(cost_map)
    except (TypeError, ValueError, RuntimeError):  # `CostMap.build` raises the error
        return {"data": cost_map, **beside}
    data = data[None] if data.ndim == 2 else data
    return {"data": data, **beside}


class BaseClient(PlanKeywords[AnchorBatch]):
    """Requests anchors from a service.

    Every method raises a `RequestError` if the service refuses, and a `TransportError` if there is
    no valid answer; see `anchorflow_client.errors`.
    """

    @abstractmethod
    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Return anchors for a request that was built before."""

    @abstractmethod
    def models(self) -> tuple[ModelCard, ...]:
        """Return the cards of all served bundles, the default first."""

    @abstractmethod
    def live(self) -> bool:
        """Return whether a service answers; False if there is no listener."""

    @abstractmethod
    def ready(self) -> bool:
        """Return whether the service takes requests now; False while it starts or stops."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection."""

    def __enter__(self: Client) -> Client:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _plan_built(self, build: Callable[[], AnchorRequest]) -> AnchorBatch:
        return self.plan_request(build())


class BaseAsyncClient(PlanKeywords[Coroutine[Any, Any, AnchorBatch]]):
    """The same methods for a program on an event loop, with concurrent requests.

    Cancelling the task that awaits an answer ends its request on this side. A client belongs to
    the event loop on which it is first used.
    """

    @abstractmethod
    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Return anchors for a request that was built before."""

    @abstractmethod
    async def models(self) -> tuple[ModelCard, ...]:
        """Return the cards of all served bundles, the default first."""

    @abstractmethod
    async def live(self) -> bool:
        """Return whether a service answers; False if there is no listener."""

    @abstractmethod
    async def ready(self) -> bool:
        """Return whether the service takes requests now; False while it starts or stops."""

    @abstractmethod
    async def aclose(self) -> None:
        """Close the connections."""

    async def __aenter__(self: AsyncClient) -> AsyncClient:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.aclose()

    async def _plan_built(self, build: Callable[[], AnchorRequest]) -> AnchorBatch:
        return await self.plan_request(build())
