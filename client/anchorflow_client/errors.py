"""The errors of the contract and of its clients, in one tree, and the base of all others.

    AnchorFlowError
    ├─ RequestError               the service refused; `code`, `field` and `http_status` say why
    │    ├─ InvalidRequest        invalid_request    422
    │    ├─ UnknownModel          unknown_model      404
    │    ├─ TooLarge              too_large          413
    │    ├─ Unauthorized          unauthorized       401
    │    ├─ Overloaded            overloaded         429, with `retry_after_s`
    │    ├─ Superseded            superseded         409
    │    ├─ DeadlineExceeded      deadline_exceeded  504
    │    ├─ NotReady              not_ready          503
    │    └─ InternalError         internal           500
    ├─ TransportError             no answer that the contract knows
    │    ├─ ConnectionFailed      nobody listens there, the connection broke, a proxy answers
    │    ├─ TimedOut              the service did not answer in time
    │    ├─ Cancelled             the caller took the request back
    │    └─ InvalidAnswer         what came is not the contract's
    ├─ UsageError                 a call that cannot be right; a `ValueError` as well
    │    └─ AbsentError           what the planner does not give; a `LookupError` as well
    └─ BundleError, ConfigError, …  of other packages, each defined where it is raised

A `RequestError` reads the same on both ends of the wire: the service raises it, `to_dict` writes
it, and the client raises what `from_dict` reads.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any


class AnchorFlowError(Exception):
    """Base of all that AnchorFlow raises on purpose."""


class UsageError(AnchorFlowError, ValueError):
    """An argument of a client, or the state of one of its objects, that allows no request."""


class AbsentError(UsageError, LookupError):
    """The answer lacks what was read of it."""


def how_to_install(extra: str) -> str:
    """Return the command that installs an extra, for a message; in a checkout it stays editable."""
    try:
        version("anchorflow")
    except PackageNotFoundError:  # the client alone
        return f"pip install 'anchorflow-client[{extra}]'"
    return f"pip install 'anchorflow[{extra}]', in a checkout pip install -e '.[{extra}]'"


class RequestError(AnchorFlowError):
    """A refused request; `field` is the JSON path of the wrong field, or None.

    The message always names the field.
    """

    code: str = "internal"
    http_status: int = 500

    def __init__(
        self, message: str, field: str | None = None, *, http_status: int | None = None
    ) -> None:
        self.message = message if _names(message, field) else f"{field}: {message}"
        self.field = field
        if http_status is not None:
            self.http_status = http_status
        super().__init__(self.message)

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """The contract's error JSON."""
        return {"error": {"code": self.code, "message": self.message, "field": self.field}}

    @classmethod
    def from_dict(
        cls,
        answer: Any,
        *,
        http_status: int | None = None,
        retry_after_s: float | None = None,
    ) -> RequestError:
        """Read the contract's error JSON back into the class that its code names.

        A code that this version does not know gives a plain `RequestError` that carries it. Raises
        `InvalidAnswer` if it is not the contract's error JSON.
        """
        error = answer.get("error") if isinstance(answer, Mapping) else None
        if not isinstance(error, Mapping):
            raise InvalidAnswer('expected {"error": {"code", "message", "field"}}')
        code, message, field = (error.get(key) for key in ("code", "message", "field"))
        if not (isinstance(code, str) and isinstance(message, str)):
            raise InvalidAnswer("expected strings for error.code and error.message")
        refusal = _CLASS_OF_CODE.get(code, RequestError)(
            message, field if isinstance(field, str) else None, http_status=http_status
        )
        refusal.code = code
        if isinstance(refusal, Overloaded):
            told_s = error.get("retry_after_s") if retry_after_s is None else retry_after_s
            refusal.retry_after_s = told_s if _is_time(told_s) else None
        return refusal


class InvalidRequest(RequestError):
    """A field is missing, unknown, of a wrong type, shape or range, or cannot be honoured."""

    code = "invalid_request"
    http_status = 422


class UnknownModel(RequestError):
    """No bundle of that name is served here."""

    code = "unknown_model"
    http_status = 404


class TooLarge(RequestError):
    """The body exceeds the service's limit."""

    code = "too_large"
    http_status = 413


class Unauthorized(RequestError):
    """The token or the password is missing or wrong, or access control denies the key."""

    code = "unauthorized"
    http_status = 401


class Overloaded(RequestError):
    """Too many requests wait already; try again after `retry_after_s` seconds, where known."""

    code = "overloaded"
    http_status = 429

    def __init__(
        self,
        message: str,
        field: str | None = None,
        *,
        http_status: int | None = None,
        retry_after_s: float | None = None,
    ) -> None:
        super().__init__(message, field, http_status=http_status)
        self.retry_after_s = retry_after_s

    def to_dict(self) -> dict[str, dict[str, Any]]:
        said = super().to_dict()
        if self.retry_after_s is not None:
            said["error"]["retry_after_s"] = self.retry_after_s
        return said


class Superseded(RequestError):
    """A newer request of the same caller took this one's place."""

    code = "superseded"
    http_status = 409


class DeadlineExceeded(RequestError):
    """`budget_ms` ran out before there was an answer."""

    code = "deadline_exceeded"
    http_status = 504


class NotReady(RequestError):
    """The service is starting or stopping."""

    code = "not_ready"
    http_status = 503


class InternalError(RequestError):
    """The service failed; its log has the cause under the request id."""


class TransportError(AnchorFlowError):
    """No answer came that the contract knows."""


class ConnectionFailed(TransportError):
    """Nobody listens there, the connection broke before the answer was complete, or a proxy before
    the service answers in its place: with status 500, 502, 503 or 504, in words of its own.
    """


class TimedOut(TransportError):
    """The service could not be reached, or did not answer, in the time allowed."""


class Cancelled(TransportError):
    """The caller took the request back before there was an answer."""


class InvalidAnswer(TransportError):
    """What came is not the contract's: another program answers there, or another version."""


def _is_time(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and 0 <= value <= sys.float_info.max


def _names(message: str, field: str | None) -> bool:
    """Return whether the message has the field as a whole word, or there is no field."""
    return field is None or bool(re.search(rf"(?<![\w.]){re.escape(field)}(?!\.?\w)", message))


_CLASS_OF_CODE = {kind.code: kind for kind in RequestError.__subclasses__()}
