"""Damaged binary bodies at the service's door: answered or refused, never a failure of its own.

ANCHORFLOW_MUTATIONS sets how many; a hundred thousand take a few minutes.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorRequest, OipCodec, Payload

COUNT = int(os.environ.get("ANCHORFLOW_MUTATIONS", "2000"))
ANSWERED = {200, 404, 413, 422}


@pytest.mark.timeout(3600)
def test_no_mutated_body_is_a_failure_of_the_service(
    service: Any,
    fields: dict[str, Any],
    mutated: Callable[[Payload, np.random.Generator], Payload],
) -> None:
    good = OipCodec().encode_request(AnchorRequest.from_fields(fields | {"num_samples": 4}))
    generator = np.random.default_rng(COUNT)
    statuses: Counter[int] = Counter()

    for _ in range(COUNT):
        bad = mutated(good, generator)
        headers = {
            "Content-Type": OipCodec.content_type,
            "Inference-Header-Content-Length": str(bad.header_length),
        }
        answer = service.request("POST", "/anchors", headers=headers, content=bad.body)
        assert answer.status_code in ANSWERED, (answer.text, bad)
        statuses[answer.status_code] += 1

    print(dict(statuses))  # noqa: T201 - shown by pytest -s, and where it fails
    assert min(statuses[200], statuses[422]) > COUNT / 20
    assert service.request("GET", "/v2/health/ready").status_code == 200
