"""The real client against the real server over a real socket."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from fastapi import FastAPI

from anchorflow_client import AnchorClient, ConnectionFailed, CostMap, UnknownModel

Listen = Callable[[FastAPI], str]


def test_a_robots_day(app: FastAPI, listen: Listen, fields: dict[str, Any]) -> None:
    grid = CostMap.build(np.zeros((3, 64, 64)), 0.1)

    with AnchorClient(listen(app), timeout_s=20) as client:
        assert client.live()
        assert client.ready()
        assert [card.name for card in client.models()] == ["lines", "bows"]
        anchors = client.plan(**fields | {"cost_map": grid, "num_samples": 64})
        with pytest.raises(UnknownModel, match="'nobody'"):
            client.plan(**fields, model="nobody")
        again = client.plan(**fields | {"cost_map": grid, "num_samples": 64})

    assert anchors.trajectories.shape == (64, 16, 2)
    np.testing.assert_array_equal(anchors.trajectories, again.trajectories)


def test_nobody_answers_where_no_server_is(fields: dict[str, Any]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]

    with AnchorClient(f"http://127.0.0.1:{port}") as client:
        assert not client.live()
        with pytest.raises(ConnectionFailed):
            client.plan(**fields)


def test_a_caller_who_hangs_up_halfway_harms_nobody(
    app: FastAPI, listen: Listen, fields: dict[str, Any]
) -> None:
    url = listen(app)
    with socket.create_connection(("127.0.0.1", urlsplit(url).port or 0)) as connection:
        head = b"POST /anchors HTTP/1.1\r\nHost: test\r\nContent-Length: 1000\r\n\r\n"
        connection.sendall(head + json.dumps(fields).encode()[:500])

    with AnchorClient(url) as client:
        assert client.plan(**fields).seed == 1
