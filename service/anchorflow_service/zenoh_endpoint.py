"""The service on a zenoh network: one replica, which answers from the same queue as HTTP."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from types import TracebackType

import zenoh

from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorRequest
from anchorflow_client.errors import InvalidRequest, RequestError, TooLarge
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.zenoh_messages import (
    AnswerAttachment,
    Load,
    ReplicaInfo,
    RequestAttachment,
    anchors_key,
    info_key,
    replica_anchors_key,
    replica_key,
)
from anchorflow_service.planning import Arrival, Call, PlanningService, internal_error

logger = logging.getLogger(__name__)


class RefusingCodec(OipCodec):
    """Raises an error in place of reading, so that an invalid query is counted as a request."""

    def __init__(self, error: RequestError) -> None:
        super().__init__()
        self._error = error

    def decode_request(self, payload: Payload) -> AnchorRequest:  # noqa: ARG002
        raise self._error


class ZenohEndpoint:
    """Answers queries on the event loop on which it is entered.

    Args:
        service: answers the requests; it stays open longer than this.
        session: an open session, closed with this.
        replica: this replica's name, unique on the network; by default the session's id.

    Raises:
        InvalidRequest: the name of the replica or of a model is not allowed in a key.
    """

    def __init__(
        self, service: PlanningService, session: zenoh.Session, *, replica: str | None = None
    ) -> None:
        self.replica = replica or str(session.zid())
        self._service = service
        self._session = session
        self._codec = OipCodec()
        self._models: dict[str, str] = {}
        """The model of every key that was ever declared."""
        for card in service.engines.cards():
            self._models |= self._keys_of(card.name)
        self._queryables: dict[str, zenoh.Queryable[None]] = {}
        self._changing = threading.Lock()
        self._is_leaving = False
        self._following = ExitStack()
        self._token: zenoh.LivelinessToken | None = None
        self._answering: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> ZenohEndpoint:
        loop = asyncio.get_running_loop()
        self._declare(info_key(self.replica), self._reply_info)
        following = self._service.engines.followed_by(partial(self._follow, loop))
        self._following.enter_context(following)
        self._follow(loop)
        # Last, so that a client that sees the token gets an answer.
        self._token = self._session.liveliness().declare_token(replica_key(self.replica))
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Accept no more queries, answer those that have arrived, and leave the network."""
        self._following.close()
        if self._token is not None:
            self._token.undeclare()
        with self._changing:  # a later change has no effect
            self._is_leaving, queryables = True, list(self._queryables.values())
        for queryable in queryables:
            await asyncio.to_thread(queryable.undeclare)
        await asyncio.sleep(0)  # received queries have become tasks now
        await asyncio.gather(*self._answering)
        await asyncio.to_thread(self._session.close)

    def _follow(self, loop: asyncio.AbstractEventLoop) -> None:
        """Declare the keys of the models that are served now, and no others; from any thread."""
        with self._changing:
            if self._is_leaving:
                return
            served = {info_key(self.replica)}
            for card in self._service.engines.cards():
                try:
                    keys = self._keys_of(card.name)
                except InvalidRequest as error:
                    logger.warning("model %s is served over HTTP alone: %s", card.name, error)
                    continue
                self._models |= keys
                served |= keys.keys()
            for key in served - self._queryables.keys():
                receive = partial(self._receive, loop, key)
                # On zenoh's reading thread: another one would have to wake first.
                self._declare(key, zenoh.handlers.Callback(receive, indirect=False))
            for key in self._queryables.keys() - served:
                self._queryables.pop(key).undeclare()

    def _keys_of(self, model: str) -> dict[str, str]:
        keys = (anchors_key(model), replica_anchors_key(self.replica, model))
        return dict.fromkeys(keys, model)

    def _declare(self, key: str, answer: Callable[[zenoh.Query], None]) -> None:
        # Complete: a query on a key that replicas share is routed to one of them.
        self._queryables[key] = self._session.declare_queryable(key, answer, complete=True)

    def _receive(self, loop: asyncio.AbstractEventLoop, key: str, query: zenoh.Query) -> None:
        """Note the time on zenoh's thread, which must not block, and start a task on the loop."""
        arrival = self._service.arrival()

        def start() -> None:
            task = loop.create_task(self._respond(query, key, arrival))
            self._answering.add(task)
            task.add_done_callback(self._answering.discard)

        loop.call_soon_threadsafe(start)

    async def _respond(self, query: zenoh.Query, key: str, arrival: Arrival) -> None:
        request_id = uuid.uuid4().hex
        call: Call | None = None
        with query:
            try:
                call = self._call(query, key, arrival, request_id)
                call.deliver = partial(self._reply, query, key, call)
                await self._service.answer(call)
                logger.debug("request %s answered in %.1f ms", call.request_id, arrival.elapsed_ms)
            except RequestError as error:
                _refuse(query, error)
            except Exception:
                failed = request_id if call is None else call.request_id
                logger.exception("request %s failed", failed, extra={"request_id": failed})
                _refuse(query, internal_error(failed))

    def _reply(self, query: zenoh.Query, key: str, call: Call, answer: Payload) -> None:
        load = self._load(answered=1)
        attachment = AnswerAttachment(answer.header_length, call.request_id, self.replica, load)
        _send_reply(query, key, answer.body, attachment.to_bytes(), self._codec.content_type)

    def _call(self, query: zenoh.Query, key: str, arrival: Arrival, request_id: str) -> Call:
        """Return the query as a call; an invalid one raises its error when it is decoded."""
        call = Call(
            payload=Payload(b"", 0),
            codec=self._codec,
            arrival=arrival,
            request_id=request_id,
            model=self._models[key],
            transport="zenoh",
        )
        try:
            attached = None if query.attachment is None else query.attachment.to_bytes()
            sent = RequestAttachment.from_bytes(attached)
            call.request_id, call.budget_ms = sent.request_id or request_id, sent.budget_ms
            size, most = len(query.payload or b""), self._service.limits.max_body_bytes
            if size > most:
                raise TooLarge(f"expected a body of at most {most} bytes, got {size}", "body")
        except RequestError as error:
            call.codec = RefusingCodec(error)
        else:
            body = b"" if query.payload is None else query.payload.to_bytes()
            call.payload = Payload(body, sent.header_length)
        return call

    def _reply_info(self, query: zenoh.Query) -> None:
        """Reply with the cards and the load, on zenoh's thread: nothing here blocks."""
        info = ReplicaInfo(
            replica=self.replica,
            ready=self._service.is_ready,
            load=self._load(),
            models=tuple(self._service.engines.cards()),
            default=self._service.engines.default,
        )
        with query:
            _send_reply(query, info_key(self.replica), info.to_bytes(), None, "application/json")

    def _load(self, *, answered: int = 0) -> Load:
        """Return the load without the `answered` requests, whose answers are being sent."""
        queue = self._service.queue
        return Load(queue.in_flight - answered, queue.num_lanes, queue.mean_service_s * 1e3)


def _send_reply(
    query: zenoh.Query, key: str, payload: bytes, attachment: bytes | None, encoding: str
) -> None:
    """Reply under the queryable's key; the client may have left meanwhile."""
    try:
        query.reply(key, payload, encoding=encoding, attachment=attachment, express=True)
    except zenoh.ZError as error:
        logger.warning("a reply on %s could not be sent: %s", key, error)


def _refuse(query: zenoh.Query, error: RequestError) -> None:
    """Reply with the contract's error JSON."""
    body = json.dumps(error.to_dict(), ensure_ascii=False, separators=(",", ":"))
    try:
        query.reply_err(body.encode(errors="replace"), encoding="application/json")
    except zenoh.ZError as failure:
        logger.warning("a refusal could not be sent: %s", failure)
