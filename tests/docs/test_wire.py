"""The request that the page on the wire shows byte by byte is the one that the codec writes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from anchorflow_client import AnchorRequest, OipCodec

PAGE = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")


def test_the_shown_header_is_the_codecs() -> None:
    payload = OipCodec().encode_request(
        AnchorRequest.build(
            cost_map={"data": np.zeros((1, 64, 64)), "resolution": 0.16},
            x_curr=[-3, 0, 0, 0, 0, 0],
            x_goal=[3, 0, 0, 0],
            num_samples=4,
            seed=1,
            sampler={"method": "midpoint", "schedule": [0.0, 0.5, 1.0]},
            budget_ms=80.0,
            request_id="r1",
        )
    )
    shown = re.search(r"Content-Length: (\d+)\n\n(\{.*?\})␠.*?\n(<.*>)\n```", PAGE, re.DOTALL)
    assert shown is not None
    length, header, tensors = shown.groups()

    assert payload.header_length == int(length)
    assert json.loads(bytes(payload.body[: int(length)])) == json.loads(header)
    sizes = map(int, re.findall(r"<(\d+) bytes>", tensors))
    assert len(payload.body) == int(length) + sum(sizes)
