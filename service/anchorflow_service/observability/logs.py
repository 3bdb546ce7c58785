"""Log records as lines: text for people, JSON for machines."""

from __future__ import annotations

import logging
import sys
from datetime import datetime, timezone
from typing import Any

import orjson

TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"

# What every record has; what a record has beside these was said in its `extra`.
_COMMON = set(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
_NOISE = {"color_message"}  # uvicorn's, for terminals


class JsonFormatter(logging.Formatter):
    """A record as one JSON object: time, level, logger, message, what `extra` held, exception."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
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
    """Send every logger's records to stderr, as `FORMATS` and from the `LEVELS` given; Python's
    warnings are records too.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if style == "json" else logging.Formatter(TEXT))
    logging.basicConfig(handlers=[handler], level=level.upper(), force=True)
    logging.captureWarnings(True)
