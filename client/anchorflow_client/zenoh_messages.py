"""Zenoh's key expressions, attachments and replica information; JSON.

anchorflow/v1/anchors/{model}                     anchors of a model, from any replica
anchorflow/v1/replica/{replica}                   the liveliness token of one replica
anchorflow/v1/replica/{replica}/anchors/{model}   anchors of a model, from this replica
anchorflow/v1/replica/{replica}/info              its cards and its load
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from anchorflow_client.codec import COMPACT, parse
from anchorflow_client.contract import ModelCard
from anchorflow_client.contract.checks import (
    Interval,
    describe,
    expected,
    fields_of,
    integer,
    number,
    text,
)
from anchorflow_client.contract.fields import BUDGET
from anchorflow_client.errors import InvalidAnswer, InvalidRequest

ROOT = "anchorflow/v1"
ALL_REPLICAS = f"{ROOT}/replica/*"
ALL_INFO = f"{ALL_REPLICAS}/info"

SPECIAL = "/*$?#"
"""Separators and wildcards of keys."""


def anchors_key(model: str) -> str:
    """Return the key on which any replica answers for a model. Raises `InvalidRequest`."""
    return f"{ROOT}/anchors/{_chunk(model, 'model')}"


def replica_key(replica: str) -> str:
    """Return the key of a replica's liveliness token. Raises `InvalidRequest`."""
    return f"{ROOT}/replica/{_chunk(replica, 'replica')}"


def replica_anchors_key(replica: str, model: str) -> str:
    """Return the key on which one replica answers for a model. Raises `InvalidRequest`."""
    return f"{replica_key(replica)}/anchors/{_chunk(model, 'model')}"


def info_key(replica: str) -> str:
    """Return the key of a replica's cards and load. Raises `InvalidRequest`."""
    return f"{replica_key(replica)}/info"


def replica_of(key: str) -> str:
    """Return the replica of a liveliness token."""
    return key.removeprefix(f"{ROOT}/replica/").partition("/")[0]


def _chunk(name: str, field: str) -> str:
    """Check a name for use between two slashes of a key."""
    printable = name.isascii() and name.isprintable() and " " not in name
    if not name or not printable or set(name) & set(SPECIAL):
        what = f"a name without spaces and {' '.join(SPECIAL)}, to stand in a key"
        raise InvalidRequest(f"expected {what}, got {describe(name)}", field)
    return name


_LENGTHS = Interval(0, 2**53)
_COUNTS = Interval(0, 2**31)
_TIMES = Interval(0.0, 1e9, "ms")


@dataclass(frozen=True)
class RequestAttachment:
    """The attachment of a query."""

    header_length: int | None = None
    """Bytes of the JSON header before the tensors."""
    request_id: str | None = None
    budget_ms: float | None = None
    """Time left to the caller, from arrival; overrides the one in the payload."""

    def to_bytes(self) -> bytes:
        """Return UTF-8 JSON without the fields that are None."""
        return _written({name: value for name, value in vars(self).items() if value is not None})

    @classmethod
    def from_bytes(cls, data: bytes | None) -> RequestAttachment:
        """Read untrusted bytes; None is an empty attachment. Raises `InvalidRequest`."""
        if data is None:
            return cls()
        said = fields_of(_parsed(data), "attachment", tuple(_CHECK_OF_FIELD))
        return cls(
            **{
                name: _CHECK_OF_FIELD[name](value, f"attachment.{name}")
                for name, value in said.items()
                if value is not None
            }
        )


_CHECK_OF_FIELD: dict[str, Any] = {
    "header_length": lambda value, field: integer(value, field, _LENGTHS),
    "request_id": text,
    "budget_ms": lambda value, field: number(value, field, BUDGET),
}


@dataclass(frozen=True)
class Load:
    """The load of a replica."""

    in_flight: int = 0
    """Requests in progress or waiting."""
    workers: int = 1
    """Requests in progress at a time, at most."""
    mean_service_ms: float = 0.0
    """Running mean of a request's time in a worker; 0 before the first."""

    def expected_ms(self, more: int = 0, *, unknown_ms: float = 0.0) -> float:
        """Return the expected time until one more request is answered.

        Args:
            more: requests that were sent and are not yet in `in_flight`.
            unknown_ms: the mean to use before the first request.
        """
        waiting = max(0, self.in_flight + more + 1 - self.workers)
        return (self.mean_service_ms or unknown_ms) * (1 + waiting / self.workers)

    @classmethod
    def from_fields(cls, value: Any) -> Load:
        """Read untrusted fields; unknown ones are ignored. Raises `InvalidRequest`."""
        if not isinstance(value, Mapping):
            raise expected("load", "an object", value)
        return cls(
            in_flight=integer(value.get("in_flight"), "load.in_flight", _COUNTS),
            workers=integer(value.get("workers"), "load.workers", Interval(1, _COUNTS.high)),
            mean_service_ms=number(value.get("mean_service_ms"), "load.mean_service_ms", _TIMES),
        )


@dataclass(frozen=True)
class AnswerAttachment:
    """The attachment of a reply."""

    header_length: int | None
    request_id: str
    replica: str
    """The replica that answered."""
    load: Load

    def to_bytes(self) -> bytes:
        """Return UTF-8 JSON."""
        return _written({**vars(self), "load": vars(self.load)})

    @classmethod
    def from_bytes(cls, data: bytes | None) -> AnswerAttachment:
        """Read untrusted bytes. Raises `InvalidAnswer`."""
        try:
            said = _parsed(data or b"")
            return cls(
                integer(said.get("header_length"), "attachment.header_length", _LENGTHS),
                text(said.get("request_id"), "attachment.request_id"),
                text(said.get("replica"), "attachment.replica"),
                Load.from_fields(said.get("load")),
            )
        except InvalidRequest as error:
            raise InvalidAnswer(f"not an answer of the contract: {error}") from error


@dataclass(frozen=True)
class ReplicaInfo:
    """A replica's cards, load and readiness."""

    replica: str
    ready: bool
    load: Load
    models: tuple[ModelCard, ...]
    """The default first."""
    default: str
    """The model of requests that name none; it may be unloaded."""

    def to_bytes(self) -> bytes:
        """Return UTF-8 JSON."""
        return _written(
            {
                "replica": self.replica,
                "ready": self.ready,
                "load": asdict(self.load),
                "models": [card.to_dict() for card in self.models],
                "default": self.default,
            }
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> ReplicaInfo:
        """Read untrusted bytes. Raises `InvalidAnswer`."""
        try:
            said = _parsed(data)
            return cls(
                replica=text(said.get("replica"), "replica"),
                ready=said.get("ready") is True,
                load=Load.from_fields(said.get("load")),
                models=tuple(map(ModelCard.from_dict, said["models"])),
                default=text(said.get("default"), "default"),
            )
        except (InvalidRequest, ValueError, TypeError, KeyError, AttributeError) as error:
            raise InvalidAnswer(f"not what a replica tells of itself: {error!r}") from error


def _written(value: Mapping[str, Any]) -> bytes:
    return COMPACT.encode(value).encode()


def _parsed(data: bytes) -> Mapping[str, Any]:
    value = parse(data, "attachment")
    if not isinstance(value, Mapping):
        raise expected("attachment", "an object", value)
    return value
