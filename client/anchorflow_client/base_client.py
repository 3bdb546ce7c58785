"""What every client of a service can do, whatever carries its requests: blocking or async."""

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
    """Asks a service for anchors.

    Every method raises a `RequestError` where the service refuses and a `TransportError` where no
    answer of the contract comes; see `anchorflow_client.errors`.
    """

    @abstractmethod
    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """`plan` for a request that was built before."""

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

    def _plan_built(self, build: Callable[[], AnchorRequest]) -> AnchorBatch:
        return self.plan_request(build())


class BaseAsyncClient(PlanKeywords[Coroutine[Any, Any, AnchorBatch]]):
    """The same for a program on an event loop, which may ask many things at the same time.

    Where the task that awaits an answer is cancelled, nothing of its request goes on here. A client
    belongs to the event loop that it is first used on.
    """

    @abstractmethod
    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """`plan` for a request that was built before."""

    @abstractmethod
    async def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served, the default first."""

    @abstractmethod
    async def live(self) -> bool:
        """Whether a service answers; False where nobody listens."""

    @abstractmethod
    async def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""

    @abstractmethod
    async def aclose(self) -> None:
        """Let go of the connections."""

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
