"""The Open Inference Protocol by hand: what its own client never sends."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

LENGTH = "Inference-Header-Content-Length"


def infer(service: Any, body: Any, model: str = "lines", **headers: str) -> Any:
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    return service.request(
        "POST", f"/v2/models/{model}/infer", headers=headers or None, content=content
    )


def arrays(answer: Any) -> dict[str, np.ndarray]:
    return {
        each["name"]: np.array(each["data"]).reshape(each["shape"])
        for each in answer.json()["outputs"]
    }


def test_the_version_in_the_path_must_be_served(service: Any, body: dict[str, Any]) -> None:
    assert infer(service, body, "lines/versions/1.2.3").status_code == 200
    refused = infer(service, body, "lines/versions/9")
    assert refused.status_code == 404
    assert refused.json()["error"]["message"] == ("model: expected version 1.2.3 of lines, got 9")
    assert service.request("GET", "/v2/models/lines/versions/9").status_code == 404
    assert service.request("GET", "/v2/models/lines/versions/1.2.3").json()["versions"] == ["1.2.3"]


def test_the_path_names_the_model(service: Any, body: dict[str, Any]) -> None:
    assert infer(service, body, "bows").json()["model_name"] == "bows"
    body["parameters"]["model"] = "lines"
    refused = infer(service, body, "bows").json()["error"]
    assert refused["message"] == "model: expected bows, as the address says, got lines"


def test_the_metadata_is_what_the_card_says(service: Any, engine: Any) -> None:
    metadata = service.request("GET", "/v2/models/lines").json()

    inputs = {each["name"]: (each["datatype"], each["shape"]) for each in metadata["inputs"]}
    assert inputs == {
        "x_curr": ("FP32", [-1, 6]),
        "warm_start": ("FP64", [-1, -1]),
        "schedule": ("FP64", [-1]),
        "obstacle_position": ("FP64", [-1, 2]),
        "obstacle_velocity": ("FP64", [-1, 2]),
        "obstacle_radius": ("FP64", [-1]),
        "obstacle_forecast": ("FP64", [-1, -1, 2]),
    }
    outputs = {each["name"]: each["shape"] for each in metadata["outputs"]}
    assert list(outputs) == list(engine.card.answer.names)
    assert outputs["velocities"] == [-1, -1, 16, 2]
    assert outputs["safe"] == [-1, -1]


def test_own_time_steps_are_an_output(free: Any, body: dict[str, Any]) -> None:
    metadata = free.request("GET", "/v2/models/lines").json()
    assert metadata["outputs"][-1] == {"name": "dt", "datatype": "FP64", "shape": [-1, -1]}

    answer = infer(free, body)

    assert "dt" not in answer.json()["parameters"]
    np.testing.assert_allclose(arrays(answer)["dt"] * 15, [1.0, 1.1, 1.2, 1.3])


@pytest.mark.parametrize(
    ("horizon_s", "outputs", "sent"),
    [
        (None, ["scores"], {"dt", "scores"}),
        (None, ["dt", "scores"], {"dt", "scores"}),
        (30.0, ["dt", "scores"], {"scores"}),  # one for all is a parameter
    ],
)
def test_own_time_steps_are_told_whatever_is_wanted(
    free: Any, body: dict[str, Any], horizon_s: float | None, outputs: list[str], sent: set[str]
) -> None:
    if horizon_s is not None:
        body["parameters"]["horizon_s"] = horizon_s
    answer = infer(free, body | {"outputs": [{"name": name} for name in outputs]})

    assert set(arrays(answer)) == sent
    assert answer.json()["parameters"].get("dt") == (2.0 if horizon_s else None)


def change(body: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """The first tensor otherwise."""
    return body | {"inputs": [body["inputs"][0] | changes, *body["inputs"][1:]]}


BINARY = {
    "name": "x_curr",
    "datatype": "FP32",
    "shape": [6],
    "parameters": {"binary_data_size": 24},
}
REFUSED: dict[str, tuple[Any, str]] = {
    "no object": (lambda _: [1], "body: expected an object"),
    "no json": (lambda _: b"{", "body: expected JSON, got text that breaks"),
    "inputs no list": (lambda _: {"inputs": {"a": 1}}, "inputs: expected a list of tensors"),
    "a number for a tensor": (lambda body: body | {"inputs": [7]}, r"inputs\[0\]: expected an obj"),
    "tensor of another planner": (
        lambda body: body | {"inputs": [*body["inputs"], body["inputs"][2] | {"name": "camera"}]},
        "inputs.camera: unknown to lines, which is asked with cost_map, x_curr, x_goal",
    ),
    "unknown type": (lambda body: change(body, datatype="BYTES"), "cost_map: expected one of FP32"),
    "shape of -6": (
        lambda body: change(body, shape=[-6]),
        "cost_map: expected a shape of whole numbers from 1 on, got -6",
    ),
    "shape too small": (lambda body: change(body, shape=[1, 16, 19]), "cost_map: expected shape"),
    "huge shape": (lambda body: change(body, shape=[2**62] * 8), "cost_map: expected shape"),
    "not a number": (
        lambda body: change(body, data=[float("nan")] * 320),
        r"expected finite numbers, got nan at cost_map\[0\]",
    ),
    "data of strings": (
        lambda body: change(body, data=["1"] * 320),
        r"expected a number at cost_map\[0\], got",
    ),
    "no data": (lambda body: change(body, data=None), r"inputs\[0\].data: this field is required"),
    "a tensor twice": (
        lambda body: body | {"inputs": [*body["inputs"], body["inputs"][0]]},
        "cost_map: expected one tensor of this name, got two",
    ),
    "binary without a length": (
        lambda body: body | {"inputs": [BINARY]},
        "x_curr: expected 24 bytes, got 0",
    ),
    "unknown output": (
        lambda body: body | {"outputs": [{"name": "paths"}]},
        "outputs: expected one of trajectories",
    ),
    "a timeout of 0": (lambda body: body | {"parameters": {"timeout": 0}}, "timeout: expected"),
    "a timeout and a budget": (
        lambda body: body | {"parameters": {"timeout": 1e6, "budget_ms": 1e3}},
        "timeout: expected this field or budget_ms, got both",
    ),
}
"""What the reader of the binary form does not see; `test_oip_hostile.py` has the rest."""


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_refused_by_name(service: Any, body: dict[str, Any], case: str) -> None:
    make, words = REFUSED[case]

    answer = infer(service, make(body))

    assert answer.status_code == 422
    assert re.match(words, answer.json()["error"]["message"]), answer.text
