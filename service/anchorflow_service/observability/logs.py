"""Log records as lines, as text for people or JSON for machines; one line per HTTP exchange."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import orjson

TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
UNROUTED = "other"
"""The route of a request that matched none."""
CLIENT_DISCONNECTED = 499
"""The status if the client disconnected before there was one, as in nginx."""

# Attributes of every record; all others are from `extra`.
_COMMON = set(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
_NOISE = {"color_message"}  # uvicorn's, for terminals

access_logger = logging.getLogger("anchorflow_service.access")


@dataclass(frozen=True)
class Exchange:
    """A request and its response's status; method and path are "-" if it was not valid HTTP."""

    method: str
    path: str
    """Percent-encoded, so that it cannot break a line of the log."""
    route: str
    """The matched template, such as /v2/models/{name}."""
    status: int
    seconds: float
    request_id: str
    caller: str | None
    """Name of the token, if tokens are required."""


Listener = Callable[[Exchange], None]


class JsonFormatter(logging.Formatter):
    """Formats a record as one JSON object: time, level, logger, message, `extra`, exception."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, timezone.utc).isoformat(
                timespec="milliseconds"
            ),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= {key: value for key, value in vars(record).items() if key not in _COMMON | _NOISE}
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return orjson.dumps(line, default=str, option=orjson.OPT_NON_STR_KEYS).decode()


def set_up_logging(style: str, level: str) -> None:
    """Log to stderr from a level on, as `text` or `json`; Python's warnings are logged too."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if style == "json" else logging.Formatter(TEXT))
    logging.basicConfig(handlers=[handler], level=level.upper(), force=True)
    logging.captureWarnings(True)
    # It warns of every client that sends nonsense; those are in the metrics.
    logging.getLogger("uvicorn.error").setLevel(logging.ERROR)


def log_exchange(exchange: Exchange) -> None:
    """Log one line at level info."""
    if not access_logger.isEnabledFor(logging.INFO):
        return
    access_logger.info(
        "%s %s %d in %.1f ms",
        exchange.method,
        exchange.path,
        exchange.status,
        exchange.seconds * 1e3,
        extra={
            "request_id": exchange.request_id,
            "method": exchange.method,
            "path": exchange.path,
            "status": exchange.status,
            "ms": round(exchange.seconds * 1e3, 3),
            "caller": exchange.caller,
        },
    )
