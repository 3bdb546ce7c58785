"""`LocalClient`: what a service refuses, it refuses too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorBatch, InternalError
from anchorflow_service.local import LocalClient


def test_an_answer_that_is_not_finite_is_none(engine: Any, fields: dict[str, Any]) -> None:
    def broken(batch: AnchorBatch) -> AnchorBatch:
        far = np.full_like(batch.trajectories, np.inf)
        return replace(batch, arrays={**batch.arrays, "trajectories": far})

    client = LocalClient(engine)
    assert client.plan(**fields).is_finite
    engine.before_answer = broken
    with pytest.raises(InternalError, match="numbers that are not finite"):
        client.plan(**fields)
