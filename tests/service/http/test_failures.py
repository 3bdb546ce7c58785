"""Failures of an engine: the caller gets `internal`, and the log has the details."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorBatch


def explode(_: AnchorBatch) -> AnchorBatch:
    raise ZeroDivisionError("secret detail")


def answer_nan(batch: AnchorBatch) -> AnchorBatch:
    broken = batch.trajectories * np.float32(np.nan)
    return replace(batch, arrays={**batch.arrays, "trajectories": broken})


def answer_infinite_clearance(batch: AnchorBatch) -> AnchorBatch:
    broken = np.full_like(batch.clearance, np.inf)
    return replace(batch, arrays={**batch.arrays, "clearance": broken})


@pytest.mark.parametrize(
    ("fault", "logged"),
    [
        (explode, "secret detail"),
        (answer_nan, "not finite"),
        (answer_infinite_clearance, "not finite"),
    ],
)
def test_a_failure_is_internal_and_logged_under_its_id(
    service: Any,
    engine: Any,
    fields: dict[str, Any],
    caplog: pytest.LogCaptureFixture,
    fault: Callable[[AnchorBatch], AnchorBatch],
    logged: str,
) -> None:
    engine.before_answer = fault
    with caplog.at_level(logging.ERROR, "anchorflow_service"):
        answer = service.post(fields | {"request_id": "r7"})

    assert answer.status_code == 500
    error = answer.json()["error"]
    assert (error["code"], error["field"]) == ("internal", None)
    assert "r7" in error["message"]
    assert "Traceback" not in answer.text
    assert logged not in answer.text
    assert "request r7 failed" in caplog.text
    assert logged in caplog.text

    engine.before_answer = lambda batch: batch
    assert service.post(fields).status_code == 200
