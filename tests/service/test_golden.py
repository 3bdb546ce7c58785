"""Golden answers: what the shipped bundles answered before format 2, in JSON, in binary, on zenoh.

The files under golden/ were recorded with the libraries and on the processor that index.json names;
elsewhere kernels round otherwise, and the test skips, saying so. What an answer has gained since
(`first_s`), the manifest's hash and the times are left out of the comparison.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import Any

import httpx
import pytest
from anyio.from_thread import start_blocking_portal

from anchorflow_client.codec import Payload
from anchorflow_client.keys import anchors_key
from anchorflow_client.oip.message import unpack_header
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_client.zenoh_messages import AnswerAttachment, RequestAttachment
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.http import create_app
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

GOLDEN = Path(__file__).parent / "golden"
INDEX = json.loads((GOLDEN / "index.json").read_text())
BUNDLES = ("default", "student")
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe")
LENGTH = "Inference-Header-Content-Length"

Post = Callable[[dict[str, str], bytes], httpx.Response]


@pytest.fixture(scope="module", autouse=True)
def recorded_here() -> None:
    """Skips where the bytes could not be the same."""
    for library in ("numpy", "onnxruntime", "scipy"):
        if version(library) != INDEX["machine"][library]:
            pytest.skip(f"the golden answers were made with {library} {INDEX['machine'][library]}")
    if processor() != INDEX["machine"]["processor"]:
        pytest.skip(f"the golden answers were made on {INDEX['machine']['processor']}")


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return "unknown"
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "unknown")


@pytest.fixture(scope="module", params=BUNDLES)
def bundle(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def planning(bundle: str) -> PlanningService:
    engine = LocalClient.of(DEFAULT_BUNDLE.parent / bundle).engine
    return PlanningService({engine.card.name: engine}, default=engine.card.name)


@pytest.fixture(scope="module")
def post(planning: PlanningService) -> Iterator[Post]:
    """Posts to /anchors of the application in this process."""
    app = create_app(planning)

    async def send(headers: dict[str, str], body: bytes) -> httpx.Response:
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.post("/anchors", headers=headers, content=body)

    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
    ):
        yield lambda headers, body: portal.call(send, headers, body)


def arrays_as_written(answer: bytes) -> dict[str, bytes]:
    """The text of every array of a JSON answer, digit by digit."""
    found = {}
    for name in ARRAYS:
        begin = answer.index(f'"{name}":'.encode()) + len(name) + 3
        depth, end = 0, begin
        while True:
            depth += {91: 1, 93: -1}.get(answer[end], 0)
            end += 1
            if not depth:
                break
        found[name] = answer[begin:end]
    return found


def told(fields: dict[str, Any]) -> dict[str, Any]:
    """What an answer says beside its arrays, without times and the manifest's hash."""
    model = {key: fields["model"][key] for key in ("name", "version")}
    return {name: fields[name] for name in ("dt", "seed", "request_id")} | {"model": model}


def tensors_of(body: bytes, length: int | None) -> tuple[dict[str, Any], bytes]:
    header, data = unpack_header(Payload(body, length))
    leaves = {k: v for k, v in header["parameters"].items() if not k.startswith("timing_ms")}
    del leaves["model.sha256"]
    leaves.pop("first_s", None)
    return {**header, "parameters": leaves}, bytes(data)


def golden(name: str, bundle: str, form: str) -> tuple[bytes, bytes]:
    """A request and its answer."""
    request = (GOLDEN / f"{name}.{form}").read_bytes()
    return request, (GOLDEN / f"{name}.{bundle}.{form}").read_bytes()


@pytest.mark.parametrize("name", INDEX["requests"])
def test_json_answers_have_the_same_digits(post: Post, bundle: str, name: str) -> None:
    request, expected = golden(name, bundle, "json")

    answer = post({"Content-Type": "application/json"}, request).content

    assert arrays_as_written(answer) == arrays_as_written(expected)
    assert told(json.loads(answer)) == told(json.loads(expected))


@pytest.mark.parametrize("name", INDEX["requests"])
def test_binary_answers_have_the_same_bytes(post: Post, bundle: str, name: str) -> None:
    request, expected = golden(name, bundle, "oip")
    length = {LENGTH: str(INDEX["requests"][name])}

    answer = post({"Content-Type": "application/octet-stream", **length}, request)

    came = tensors_of(answer.content, int(answer.headers[LENGTH]))
    assert came == tensors_of(expected, INDEX["answers"][f"{name}.{bundle}"])


@pytest.mark.parametrize("name", INDEX["requests"])
def test_zenoh_answers_have_the_same_bytes(
    planning: PlanningService, bundle: str, name: str
) -> None:
    request, expected = golden(name, bundle, "oip")
    attachment = RequestAttachment(INDEX["requests"][name]).to_bytes()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
    with start_blocking_portal() as portal, planning, ExitStack() as stack:
        replica = ZenohEndpoint(planning, open_session(ZenohSettings(listen=(address,))))
        stack.enter_context(portal.wrap_async_context_manager(replica))
        session = open_session(ZenohSettings(connect=(address,)), wait_s=10)
        stack.callback(session.close)

        key = anchors_key(planning.engines.default)
        (reply,) = session.get(key, payload=request, attachment=attachment)

    assert reply.ok is not None
    said = AnswerAttachment.from_bytes(reply.ok.attachment.to_bytes())
    came = tensors_of(reply.ok.payload.to_bytes(), said.header_length)
    assert came == tensors_of(expected, INDEX["answers"][f"{name}.{bundle}"])
