"""The codec: how a request and an answer become bytes, whatever carries them.

Clients and services hold a `Codec` and never look inside, so that another form of the contract, or
a faster writer of the same form, is one more class.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.errors import InvalidAnswer


@dataclass(frozen=True)
class Payload:
    """Bytes on their way, in HTTP's body or in zenoh's payload."""

    body: bytes
    header_length: int | None = None
    """Bytes of JSON before the tensors; None where the form has no such header."""


class Codec(Protocol):
    """One form of the contract on the wire."""

    @property
    def content_type(self) -> str:
        """The media type that names this form."""
        ...

    def encode_request(self, request: AnchorRequest) -> Payload:
        """What a client sends."""
        ...

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """What a service received.

        Raises:
            InvalidRequest: names the field, or "body" where the bytes cannot be read at all.
        """
        ...

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        """What a service sends.

        Raises:
            ValueError: a number is not finite.
        """
        ...

    def decode_answer(self, payload: Payload) -> AnchorBatch:
        """What a client received.

        Raises:
            InvalidAnswer: the bytes are not the contract's.
        """
        ...


def answer_to(request: AnchorRequest, answer: AnchorBatch) -> AnchorBatch:
    """The answer. Raises `InvalidAnswer` where the request was named, and it is another's."""
    if request.request_id is not None and answer.request_id != request.request_id:
        wanted, came = request.request_id, answer.request_id
        raise InvalidAnswer(f"request_id: expected the answer to {wanted}, got that to {came}")
    return answer
