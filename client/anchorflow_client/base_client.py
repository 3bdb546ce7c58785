"""The interface that every client implements, in a blocking and an async form."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, TypeVar

from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.plan_keywords import PlanKeywords

Client = TypeVar("Client", bound="BaseClient")
AsyncClient = TypeVar("AsyncClient", bound="BaseAsyncClient")


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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
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

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.aclose()

    async def _plan_built(self, build: Callable[[], AnchorRequest]) -> AnchorBatch:
        return await self.plan_request(build())
