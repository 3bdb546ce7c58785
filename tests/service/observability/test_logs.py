"""A record is a line: as JSON for machines, as text for people."""

from __future__ import annotations

import io
import json
import logging
import warnings
from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import pytest

from anchorflow_service.observability.logs import (
    Exchange,
    JsonFormatter,
    log_exchange,
    set_up_logging,
)

EXCHANGE = Exchange(
    method="POST",
    path="/anchors",
    route="/anchors",
    status=422,
    seconds=0.0123,
    request_id="r7",
    caller="robot-7",
)


@pytest.fixture
def root() -> Iterator[logging.Logger]:
    """The root logger, whose handlers are put back."""
    logger = logging.getLogger()
    handlers, level = logger.handlers[:], logger.level
    yield logger
    logger.handlers[:] = handlers
    logger.setLevel(level)
    logging.captureWarnings(False)


def lines_of(root: logging.Logger, style: str, level: str = "info") -> io.StringIO:
    out = io.StringIO()
    set_up_logging(style, level)
    (handler,) = root.handlers
    assert isinstance(handler, logging.StreamHandler)
    handler.setStream(out)
    return out


def test_an_exchange_is_a_json_line_with_its_id(root: logging.Logger) -> None:
    out = lines_of(root, "json")

    log_exchange(EXCHANGE)

    line: dict[str, Any] = json.loads(out.getvalue())
    time = datetime.fromisoformat(line.pop("time"))
    assert abs(datetime.now(time.tzinfo) - time) < timedelta(minutes=1)
    assert line == {
        "level": "info",
        "logger": "anchorflow_service.access",
        "message": "POST /anchors 422 in 12.3 ms",
        "request_id": "r7",
        "method": "POST",
        "path": "/anchors",
        "status": 422,
        "ms": 12.3,
        "caller": "robot-7",
    }


def test_an_exception_stays_on_its_line(root: logging.Logger) -> None:
    out = lines_of(root, "json")
    logger = logging.getLogger("anchorflow_service.test")
    try:
        raise ValueError("two\nlines")
    except ValueError:
        logger.exception("request %s failed", "r7", extra={"request_id": "r7", "odd": {1, 2}})

    (line,) = out.getvalue().splitlines()
    record = json.loads(line)
    assert record["message"] == "request r7 failed"
    assert record["request_id"] == "r7"
    assert "Traceback" in record["exception"]
    assert "ValueError: two\nlines" in record["exception"]


def test_a_warning_is_a_line_like_any_other(root: logging.Logger) -> None:
    out = lines_of(root, "json")
    with np.errstate(all="warn"), warnings.catch_warnings():
        warnings.simplefilter("always")
        np.float64(1e300).astype(np.float32)

    (line,) = map(json.loads, out.getvalue().splitlines())
    assert (line["level"], line["logger"]) == ("warning", "py.warnings")
    assert "RuntimeWarning: overflow encountered in cast" in line["message"]


def test_what_a_caller_sent_cannot_begin_a_line(root: logging.Logger) -> None:
    out = lines_of(root, "json")
    logging.getLogger("anchorflow_service.test").warning("got %s", 'a\n{"level": "info"}\u2028')

    assert len(out.getvalue().splitlines()) == 1 or out.getvalue().count("\n") == 1
    assert json.loads(out.getvalue())["level"] == "warning"


def test_text_is_for_people(root: logging.Logger) -> None:
    out = lines_of(root, "text")
    log_exchange(EXCHANGE)

    assert out.getvalue().endswith("INFO anchorflow_service.access: POST /anchors 422 in 12.3 ms\n")


def test_the_level_is_the_one_that_was_asked_for(root: logging.Logger) -> None:
    out = lines_of(root, "text", "warning")
    log_exchange(EXCHANGE)

    assert out.getvalue() == ""


def test_a_record_of_any_library_is_written() -> None:
    record = logging.makeLogRecord({"msg": "%d of %s", "args": (1, b"\xff"), "color_message": "x"})

    line = json.loads(JsonFormatter().format(record))

    assert line["message"] == "1 of b'\\xff'"
    assert "color_message" not in line
