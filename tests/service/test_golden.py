"""Golden answers of a bundle written by hand: in JSON, in binary and on zenoh.

They prove that the way of a request through conditioning, routes, flow, finish and codecs gives the
bytes that it gave when they were recorded, with anchors of their own durations, with a batch, with
a warm start, with a horizon. They say nothing of the bundles that ship, whose answers change with
their weights.

The files under golden/ hold the request and the machine that they were recorded on: elsewhere
kernels round otherwise, and the tests skip, saying so. With ANCHORFLOW_WRITE_GOLDEN set they are
written instead. The manifest's hash and the times are left out of the comparison.
"""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from anyio.from_thread import start_blocking_portal

from anchorflow_client import AnchorRequest, JsonCodec, OipCodec, Payload
from anchorflow_client.oip_message import unpack_header
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_client.zenoh_messages import AnswerAttachment, RequestAttachment, anchors_key
from anchorflow_service.http import create_app
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

GOLDEN = Path(__file__).parent / "golden"
WRITES = "ANCHORFLOW_WRITE_GOLDEN" in os.environ
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe")
LENGTH = "Inference-Header-Content-Length"

REST = [0.0, 0.0]
START, GOAL = [-3.0, 0.1, 0.5, 0.0, *REST], [3.0, 0.2, *REST]
COMMON = {"num_samples": 6, "seed": 7, "request_id": "golden", "x_curr": START, "x_goal": GOAL}
REFINED = {"project": True, "barrier": True, "guidance": 0.5, "certified_margin": 0.05}
REQUESTS: dict[str, dict[str, Any]] = {
    "own_durations": COMMON | {"refine": {"project": True}, "w_style": "efficient"},
    "batched": COMMON | {"x_goal": [GOAL, [2.0, -2.5, 0.4, 0.0]], "v_max": 1.1, "refine": REFINED},
    "warm": COMMON
    | {"warm_start": {"trajectory": [START[:2], [0.0, 1.5], GOAL[:2]], "tau": 0.75, "dt": 2.0}},
    "horizon": COMMON | {"horizon_s": 11.0, "refine": {"project": True}},
}

Post = Callable[[str, Payload], httpx.Response]


@pytest.fixture(params=REQUESTS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def engine(free_bundle_built: Path) -> Any:
    return LocalClient.of(free_bundle_built, threads=2).engine


@pytest.fixture
def planning(engine: Any) -> PlanningService:
    return PlanningService({engine.card.name: engine}, default=engine.card.name)


@pytest.fixture
def post(planning: PlanningService) -> Iterator[Post]:
    """Posts a body to /anchors of the application in this process."""
    app = create_app(planning)

    async def send(content_type: str, sent: Payload) -> httpx.Response:
        headers = {"Content-Type": content_type}
        if sent.header_length is not None:
            headers[LENGTH] = str(sent.header_length)
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.post("/anchors", headers=headers, content=sent.body)

    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
    ):
        yield lambda content_type, sent: portal.call(send, content_type, sent)


def asked(name: str) -> AnchorRequest:
    """On a map of 8 m with an obstacle in its middle and soft ground on one side of it."""
    data = np.zeros((3, 16, 16), np.float32)
    data[0, 7:9, 7:9] = 1.0
    data[1], data[2, 9:, :] = 1.0, 0.5
    return AnchorRequest.from_fields(
        REQUESTS[name] | {"cost_map": {"data": data, "resolution": 0.5}}
    )


def recorded(name: str, form: str, came: dict[str, Any]) -> dict[str, Any]:
    """Read a recorded answer; skip on machines that cannot reproduce its bytes."""
    path = GOLDEN / f"{name}.{form}.json"
    here = {"request": REQUESTS[name], "machine": machine()}
    if WRITES:
        path.write_text(json.dumps(here | {"answer": came}, indent=1) + "\n")
    found = json.loads(path.read_text())
    assert found["request"] == here["request"]
    if found["machine"] != here["machine"]:
        pytest.skip(f"the golden answers were made with {found['machine']}")
    return found["answer"]


def machine() -> dict[str, str]:
    libraries = {library: version(library) for library in ("numba", "numpy", "onnxruntime")}
    return {"processor": processor()} | libraries


def processor() -> str:
    """What decides which kernels run: one model name covers several generations."""
    try:
        first, _, _ = Path("/proc/cpuinfo").read_text().partition("\n\n")
    except OSError:
        return "unknown"
    pairs = (line.partition(":")[::2] for line in first.splitlines())
    facts = {key.strip(): value.strip() for key, value in pairs}
    told = [f"{key} {facts.get(key)}" for key in ("cpu family", "model", "stepping")]
    vectors = sorted(flag for flag in facts.get("flags", "").split() if flag.startswith("avx"))
    return ", ".join([facts.get("model name", "unknown"), *told, *vectors])


def in_json(answer: bytes) -> dict[str, Any]:
    """The text of every array of a JSON answer, digit by digit, and what it says beside them."""
    fields = json.loads(answer)
    arrays = {}
    for name in ARRAYS:
        begin = answer.index(f'"{name}":'.encode()) + len(name) + 3
        depth, end = 0, begin
        while True:
            depth += {91: 1, 93: -1}.get(answer[end], 0)
            end += 1
            if not depth:
                break
        arrays[name] = answer[begin:end].decode()
    model = {key: fields["model"][key] for key in ("name", "version")}
    told = {name: fields[name] for name in ("dt", "seed", "request_id")}
    return {"arrays": arrays, "told": told | {"model": model}}


def in_binary(body: bytes, length: int | None) -> dict[str, Any]:
    """The header of a binary answer, and its tensors in hexadecimal digits."""
    header, data = unpack_header(Payload(body, length))
    leaves = {k: v for k, v in header["parameters"].items() if not k.startswith("timing_ms")}
    del leaves["model.sha256"]
    text = bytes(data).hex()
    lines = [text[i : i + 96] for i in range(0, len(text), 96)]
    return {"header": {**header, "parameters": leaves}, "hex": lines}


def test_json_answers_have_the_same_digits(post: Post, name: str) -> None:
    codec = JsonCodec()
    answer = post(codec.content_type, codec.encode_request(asked(name))).content

    came = in_json(answer)
    assert came == recorded(name, "text", came)


def test_binary_answers_have_the_same_bytes(post: Post, name: str) -> None:
    codec = OipCodec()
    answer = post(codec.content_type, codec.encode_request(asked(name)))

    came = in_binary(answer.content, int(answer.headers[LENGTH]))
    assert came == recorded(name, "binary", came)


def test_zenoh_answers_have_the_same_bytes(planning: PlanningService, name: str) -> None:
    sent = OipCodec().encode_request(asked(name))
    assert sent.header_length is not None
    attachment = RequestAttachment(sent.header_length).to_bytes()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
    with start_blocking_portal() as portal, planning, ExitStack() as stack:
        replica = ZenohEndpoint(planning, open_session(ZenohSettings(listen=(address,))))
        stack.enter_context(portal.wrap_async_context_manager(replica))
        session = open_session(ZenohSettings(connect=(address,)), wait_s=10)
        stack.callback(session.close)

        key = anchors_key(planning.engines.default)
        (reply,) = session.get(key, payload=sent.body, attachment=attachment)

    assert reply.ok is not None
    said = AnswerAttachment.from_bytes(reply.ok.attachment.to_bytes())
    came = in_binary(reply.ok.payload.to_bytes(), said.header_length)
    assert came == recorded(name, "binary", came)
