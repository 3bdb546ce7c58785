"""Callers that ask a planner again and again, and what became of each question."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from ipaddress import ip_address
from itertools import cycle, islice
from time import perf_counter
from urllib.parse import urlsplit

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.turns import p50, p99
from anchorflow_client.codec import Codec
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelId
from anchorflow_client.errors import AnchorFlowError, Overloaded
from anchorflow_client.http import AnchorClient
from anchorflow_client.retry import RetryingClient

Ask = Callable[[AnchorRequest], AnchorBatch]
Connect = Callable[[ExitStack], Ask]
"""Opens what one caller needs, to be closed by the stack, and gives its way to ask."""

TIMEOUT_S = 120.0


@dataclass
class Outcomes:
    """What became of the questions that several callers asked; they share it under its lock."""

    ms: list[float] = field(default_factory=list)
    """Of each answer, from asking to having the whole of it."""
    errors: Counter[str] = field(default_factory=Counter)
    """By code, or by class where no answer of the contract came."""
    models: Counter[ModelId] = field(default_factory=Counter)
    """Those that answered."""
    elapsed_s: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def ask(self, ask: Ask, request: AnchorRequest) -> AnchorBatch:
        """Ask, and note what comes of it; an error is raised as it is."""
        start = perf_counter()
        try:
            answer = ask(request)
        except AnchorFlowError as error:
            with self.lock:
                self.errors[getattr(error, "code", type(error).__name__)] += 1
            raise
        ms = (perf_counter() - start) * 1e3
        with self.lock:
            self.ms.append(ms)
            self.models[answer.model] += 1
        return answer

    def __add__(self, other: Outcomes) -> Outcomes:
        """The outcomes of two rounds, one after the other."""
        return Outcomes(
            self.ms + other.ms,
            self.errors + other.errors,
            self.models + other.models,
            self.elapsed_s + other.elapsed_s,
        )

    @property
    def failed(self) -> int:
        return self.errors.total()

    @property
    def per_second(self) -> float:
        """Answers."""
        return len(self.ms) / self.elapsed_s

    @property
    def p50_ms(self) -> float | None:
        return p50(self.ms) if self.ms else None

    @property
    def p99_ms(self) -> float | None:
        return p99(self.ms) if self.ms else None

    @property
    def longest_ms(self) -> float | None:
        return max(self.ms, default=None)

    def late(self, budget_ms: float) -> int:
        """Answers that came later than the budget and a tenth of it."""
        return sum(ms > 1.1 * budget_ms for ms in self.ms)


def over_http(url: str, codec: Codec | None = None) -> Connect:
    """Callers of a server on this machine, each with a connection that is kept alive.

    Args:
        url: of the server.
        codec: the form of what is sent and answered, binary by default.

    Raises:
        BenchmarkError: the URL names another machine, which is nobody's to load.
    """
    check_loopback(url)
    return lambda stack: (
        stack.enter_context(AnchorClient(url, timeout_s=TIMEOUT_S, codec=codec)).plan_request
    )


class NotedClient(AnchorClient):
    """Notes each of its attempts."""

    def __init__(self, url: str, attempts: Outcomes, *, timeout_s: float) -> None:
        super().__init__(url, timeout_s=timeout_s)
        self._attempts = attempts

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """As the client's own."""
        return self._attempts.ask(super().plan_request, request)


def retrying(url: str, attempts: Outcomes, *, timeout_s: float, patience_s: float) -> Connect:
    """Callers of a server on this machine who ask again after an error that may pass.

    Args:
        url: of the server.
        attempts: notes what became of each single attempt.
        timeout_s: of an attempt.
        patience_s: from the first attempt to the beginning of the last, at most.

    Raises:
        BenchmarkError: the URL names another machine.
    """
    check_loopback(url)

    def connect(stack: ExitStack) -> Ask:
        client = NotedClient(url, attempts, timeout_s=timeout_s)
        return stack.enter_context(RetryingClient(client, patience_s=patience_s)).plan_request

    return connect


@contextmanager
def asking(
    connect: Connect,
    requests: Sequence[AnchorRequest],
    *,
    callers: int,
    seconds: float,
    questions: int | None = None,
) -> Iterator[Outcomes]:
    """Callers on threads of their own, each of which asks again as soon as it has its answer.

    One that is told to come back later waits for so long. The block runs beside them, and is left
    when they have ended: after `seconds` or after `questions` in all, whichever comes first, or
    at once where it raises. Only then are the outcomes whole.
    """
    outcomes, enough, left = Outcomes(), threading.Event(), iter(range(questions or 2**63))

    def go_on() -> bool:
        with outcomes.lock:
            return not enough.is_set() and perf_counter() < until and next(left, None) is not None

    def ask_on(ask: Ask, first: int) -> None:
        for request in islice(cycle(requests), first % len(requests), None):
            if not go_on():
                return
            try:
                outcomes.ask(ask, request)
            except Overloaded as error:
                enough.wait(max(0.0, min(error.retry_after_s or 0.0, until - perf_counter())))
            except AnchorFlowError:
                continue  # it is among the outcomes

    with ExitStack() as stack:
        asks = [connect(stack) for _ in range(callers)]
        start = perf_counter()
        until = start + seconds
        threads = [threading.Thread(target=ask_on, args=(ask, k)) for k, ask in enumerate(asks)]
        for thread in threads:
            thread.start()
        try:
            yield outcomes
        except BaseException:
            enough.set()
            raise
        finally:
            for thread in threads:
                thread.join()
            outcomes.elapsed_s = perf_counter() - start


def check_loopback(url: str) -> None:
    """Raises `BenchmarkError` where the URL names another machine, which is nobody's to load."""
    host = urlsplit(url).hostname or ""
    with suppress(ValueError):
        if host == "localhost" or ip_address(host).is_loopback:
            return
    raise BenchmarkError(
        f"expected a URL of this machine, such as http://127.0.0.1:8000, got {url}"
    )
