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
import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from golden_file import golden
from served import TRANSPORTS, in_process, on_zenoh, sent_over_http, sent_over_zenoh

from anchorflow_client import AnchorRequest, JsonCodec, OipCodec, Payload
from anchorflow_client.oip_message import unpack_header
from anchorflow_service.http import create_app
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService

GOLDEN = Path(__file__).parent / "golden"
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe")

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


@pytest.fixture(scope="module")
def engine(free_bundle_built: Path) -> Any:
    return LocalClient.of(free_bundle_built, threads=2).engine


@pytest.fixture
def planning(engine: Any) -> PlanningService:
    return PlanningService({engine.card.name: engine}, default=engine.card.name)


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
    here = {"request": REQUESTS[name], "machine": machine()}
    found = golden(GOLDEN / f"{name}.{form}.json", here | came)
    assert found["request"] == here["request"]
    if found["machine"] != here["machine"]:
        pytest.skip(f"the golden answers were made with {found['machine']}")
    return {key: found[key] for key in came}


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


def in_json(payload: Payload) -> dict[str, Any]:
    """The text of every array of a JSON answer, digit by digit, and what it says beside them."""
    fields, text = json.loads(payload.body), payload.body.decode()
    found = {name: re.search(rf'"{name}":(\[[^"}}]*\])', text) for name in ARRAYS}
    arrays = {name: array and array[1] for name, array in found.items()}
    model = {key: fields["model"][key] for key in ("name", "version")}
    told = {name: fields[name] for name in ("dt", "seed", "request_id")}
    return {"arrays": arrays, "told": told | {"model": model}}


def in_binary(answer: Payload) -> dict[str, Any]:
    """The header of a binary answer, and its tensors in hexadecimal digits."""
    header, data = unpack_header(answer)
    leaves = {k: v for k, v in header["parameters"].items() if not k.startswith("timing_ms")}
    del leaves["model.sha256"]
    return {"header": {**header, "parameters": leaves}, "hex": bytes(data).hex()}


@pytest.mark.parametrize("name", REQUESTS)
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_answers_have_the_same_digits(planning: PlanningService, transport: str, name: str) -> None:
    codec = JsonCodec() if transport == "json" else OipCodec()
    sent = codec.encode_request(asked(name))
    if transport == "zenoh":
        with on_zenoh(planning) as endpoint:
            answer = sent_over_zenoh(endpoint, planning.engines.default, sent)
    else:
        with in_process(create_app(planning)) as app:
            answer = sent_over_http(app, codec, sent)

    came = in_json(answer) if transport == "json" else in_binary(answer)
    assert came == recorded(name, "text" if transport == "json" else "binary", came)
