"""What a service answers before its bundles are loaded."""

from __future__ import annotations

import httpx

from anchorflow_cli.listening import listen, url_of
from anchorflow_service.http.starting import answering_not_ready


def test_a_starting_service_shows_its_page_and_refuses_by_name() -> None:
    with listen("127.0.0.1", 0) as listener, httpx.Client(base_url=url_of(listener)) as client:
        with answering_not_ready(listener, lambda: "it compiles"):
            assert "text/html" in client.get("/").headers["content-type"]
            assert client.get("/page/js/app.js").status_code == 200
            assert client.get("/v2/health/live").json() == {"live": True}
            for refused in (client.get("/v2/health/ready"), client.post("/anchors", json={})):
                error = {"code": "not_ready", "message": "it compiles", "field": None}
                assert (refused.status_code, refused.json()) == (503, {"error": error})
        # The next server takes the same socket.
        with answering_not_ready(listener, lambda: "again"):
            assert client.get("/v2/models").json()["error"]["message"] == "again"
