"""The protocol's own Python client, over a socket: health, metadata, anchors, bundles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from served import app_of

from anchorflow_client import AnchorClient

triton = pytest.importorskip("tritonclient.http", reason="tritonclient[http] is not installed")
Refused = pytest.importorskip("tritonclient.utils").InferenceServerException

PATIENCE_S = 20.0


@pytest.fixture
def app(tiny_bundle: Path) -> FastAPI:
    return app_of(tiny_bundle)


@pytest.fixture
def url(app: FastAPI, listen: Callable[[FastAPI], str]) -> str:
    return listen(app)


@pytest.fixture
def client(url: str) -> Iterator[Any]:
    address = url.removeprefix("http://")
    with triton.InferenceServerClient(address, network_timeout=PATIENCE_S) as client:
        yield client


@pytest.fixture
def asked() -> dict[str, np.ndarray]:
    """A scene with an obstacle, as the client's tensors."""
    occupancy = np.zeros((1, 16, 16), np.float32)
    occupancy[0, 7:9, 7:9] = 1.0
    return {
        "cost_map": occupancy,
        "map_geometry": np.array([-4.0, -4.0, 0.5], np.float32),
        "x_curr": np.array([-3.0, 0.1, 0.5, 0.0, 0.0, 0.0]),
        "x_goal": np.array([3.0, 0.2, 0.0, 0.0]),
    }


def inputs_of(arrays: dict[str, np.ndarray], *, binary: bool = True) -> list[Any]:
    inputs = []
    for name, array in arrays.items():
        datatype = "FP32" if array.dtype == np.float32 else "FP64"
        inputs.append(triton.InferInput(name, list(array.shape), datatype))
        inputs[-1].set_data_from_numpy(array, binary_data=binary)
    return inputs


def test_health_and_metadata(client: Any) -> None:
    assert client.is_server_live()
    assert client.is_server_ready()
    assert client.is_model_ready("tiny")
    assert client.is_model_ready("tiny", "1.2.3")
    assert not client.is_model_ready("tiny", "9")
    assert not client.is_model_ready("nobody")
    server = client.get_server_metadata()
    assert (server["name"], "binary_tensor_data" in server["extensions"]) == ("anchorflow", True)
    model = client.get_model_metadata("tiny", "1.2.3")
    assert (model["name"], model["versions"]) == ("tiny", ["1.2.3"])
    shapes = {tensor["name"]: tensor["shape"] for tensor in model["inputs"] + model["outputs"]}
    assert shapes["x_curr"] == [-1, 6]
    assert shapes["trajectories"] == [-1, -1, 8, 2]


@pytest.mark.parametrize("binary", [True, False])
def test_anchors_are_those_of_our_own_client(
    client: Any, url: str, asked: dict[str, np.ndarray], binary: bool
) -> None:
    parameters = {"num_samples": 5, "seed": 7, "refine.project": True}
    result = client.infer(
        "tiny", inputs_of(asked, binary=binary), request_id="r1", parameters=parameters
    )
    with AnchorClient(url) as ours:
        expected = ours.plan(
            cost_map=asked["cost_map"],
            resolution=0.5,
            x_curr=asked["x_curr"],
            x_goal=asked["x_goal"],
            num_samples=5,
            seed=7,
            refine={"project": True},
        )

    for name in ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe"):
        np.testing.assert_array_equal(result.as_numpy(name), getattr(expected, name))
    said = result.get_response()
    assert (said["id"], said["model_name"], said["model_version"]) == ("r1", "tiny", "1.2.3")
    assert said["parameters"]["seed"] == 7
    assert said["parameters"]["model.sha256"] == expected.model.sha256


def test_some_of_the_outputs_in_either_form(client: Any, asked: dict[str, np.ndarray]) -> None:
    outputs = [
        triton.InferRequestedOutput("scores", binary_data=False),
        triton.InferRequestedOutput("trajectories", binary_data=True),
    ]
    result = client.infer("tiny", inputs_of(asked), outputs=outputs, parameters={"num_samples": 3})

    assert result.as_numpy("trajectories").shape == (3, 8, 2)
    assert result.as_numpy("scores").shape == (3,)
    assert "data" in result.get_output("scores")
    assert "data" not in result.get_output("trajectories")
    assert result.as_numpy("clearance") is None


def test_refusals_reach_the_caller(client: Any, asked: dict[str, np.ndarray]) -> None:
    for model, parameters, words in (
        ("nobody", {}, "expected a model that is served"),
        ("tiny", {"num_samples": 0}, "num_samples: expected an integer"),
    ):
        with pytest.raises(Refused) as caught:
            client.infer(model, inputs_of(asked), parameters=parameters)
        assert words in str(caught.value.message())


def test_a_timeout_in_microseconds_is_the_budget(client: Any, asked: dict[str, np.ndarray]) -> None:
    assert client.infer("tiny", inputs_of(asked), timeout=60_000_000)
    with pytest.raises(Refused) as caught:
        client.infer("tiny", inputs_of(asked), timeout=1)
    assert caught.value.status() == "504"
    assert "budget_ms: expected an answer within 0.001 ms" in str(caught.value.message())


def test_bundles_come_and_go(client: Any) -> None:
    assert client.get_model_repository_index() == [
        {"name": "tiny", "version": "1.2.3", "state": "READY", "reason": ""}
    ]
    client.unload_model("tiny")
    assert not client.is_model_ready("tiny")
    assert client.get_model_repository_index()[0]["state"] == "UNAVAILABLE"
    client.load_model("tiny")
    assert client.is_model_ready("tiny")
