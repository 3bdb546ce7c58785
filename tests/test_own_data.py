"""Recordings become a served bundle by commands alone, by way of a teacher and its student."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from anchorflow_cli.main import main
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService
from anchorflow_training.dataset import SceneDataset, open_dataset

SHORT = ("--steps", 3, "--scenes", 4, "--samples", 4, "--no-tensorboard")
SMALL = ("--model.map-size", 16, "--model.layers", 1, "--model.map-attention")
FEW = ("--teacher.pairs", 2, "--teacher.steps", 1, "--schedule", "0,0.8,1")
N, CELLS, RADIUS = 6, 32, 0.4


def anchorflow(*words: object) -> None:
    """Runs a command line, which must succeed."""
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in words])
    assert caught.value.code == 0


def data_of(poses: Path, folder: Path, *cut: object) -> SceneDataset:
    """From recorded poses to scenes by the commands of docs/training-data.md."""
    anchorflow("data", "from-poses", poses, folder / "my.npz", *cut)
    robot = ("--robot-radius", RADIUS)
    anchorflow("data", "import", folder / "my.npz", folder / "data", "--cells", CELLS, *robot)
    return open_dataset(folder / "data")


def student_of(folder: Path) -> Engine:
    """Train on those scenes, teach a student, export it and open it."""
    anchorflow("train", folder / "data", "--out", folder / "run", *SHORT, *SMALL)
    teacher, student = folder / "run" / "checkpoint.pt", folder / "student"
    anchorflow("distill", teacher, folder / "data", "--out", student, *SHORT, *FEW)
    checkpoint, bundle = student / "checkpoint.pt", folder / "bundle"
    anchorflow("export", checkpoint, "--out", bundle, "--refine-steps", 2)
    return Engine(load_bundle(bundle), threads=1)


def write_drive(folder: Path) -> None:
    """A KITTI pose file of a slow drive in bends: 12 numbers a line, a camera's 3 x 4 pose."""
    time = np.arange(60) * 0.1
    heading = 0.7 + 0.5 * np.sin(time)
    speed = 1.0 + 0.2 * np.cos(1.7 * time)
    x, y = np.cumsum(speed * np.cos(heading)) * 0.1, np.cumsum(speed * np.sin(heading)) * 0.1
    cos, sin, zero = np.cos(heading), np.sin(heading), np.zeros_like(time)
    rows = [cos, zero, -sin, -y, zero, zero + 1, zero, zero, sin, zero, cos, x]
    np.savetxt(folder / "00.txt", np.stack(rows, 1))


def request_of(folder: Path) -> dict[str, Any]:
    """Build a request from start to end of a recorded trajectory on a free map."""
    with np.load(folder / "my.npz") as recorded:
        p, v, a = (recorded[name][-1] for name in ("positions", "velocities", "accelerations"))
    half = float(np.abs(p[:, :2]).max()) + 5.0
    return {
        "cost_map": {
            "data": np.zeros((1, CELLS, CELLS)).tolist(),
            "resolution": 2.0 * half / CELLS,
        },
        "x_curr": np.concatenate([p[0], v[0], a[0]]).tolist(),
        "x_goal": np.concatenate([p[-1], v[-1]]).tolist(),
        "num_samples": N,
        "seed": 1,
    }


def post(engine: Engine, body: dict[str, Any]) -> httpx.Response:
    """One POST /anchors to the application in this process."""
    name = engine.card.name
    app = create_app(PlanningService({name: engine}, default=name))

    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app=app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://test") as client,
        ):
            return await client.post("/anchors", json=body)

    return asyncio.run(ask())


def assert_served(engine: Engine, folder: Path, *, T: int, D: int) -> None:
    """Its T, D and robot are the data's, its anchors meet both ends, another D is refused."""
    assert (engine.card.T, engine.card.D) == (T, D)
    assert engine.card.cost_map.limits.robot_radius == RADIUS
    assert engine.card.time.dt == pytest.approx(0.1)
    shapes = {spec.name: spec.shape for spec in engine.card.inputs}
    assert (shapes["x_curr"], shapes["x_goal"]) == (("B", 3 * D), ("B", 2 * D))
    body = request_of(folder)

    answer = post(engine, body)
    assert answer.status_code == 200, answer.text
    ends = {"trajectories": (0, 0), "velocities": (D, D)}
    for name, (of_start, of_goal) in ends.items():
        values = np.array(answer.json()[name])
        assert values.shape == (N, T, D)
        start, goal = body["x_curr"][of_start:][:D], body["x_goal"][of_goal:][:D]
        np.testing.assert_allclose(values[:, 0], [start] * N, atol=1e-3)
        np.testing.assert_allclose(values[:, -1], [goal] * N, atol=1e-3)
    assert np.array(answer.json()["accelerations"]).shape == (N, T, D)

    other = 5 - D
    refused = post(engine, body | {"x_curr": [0.0] * 3 * other, "x_goal": [0.0] * 2 * other})
    assert refused.status_code == 422
    assert refused.json()["error"]["field"] == "x_curr"
    assert f"expected shape [{3 * D}]" in refused.json()["error"]["message"]


def test_recorded_poses_become_a_served_student(tmp_path: Path) -> None:
    """Of 20 time steps, which are no multiple of what a token of the network covers."""
    (tmp_path / "poses").mkdir()
    write_drive(tmp_path / "poses")
    data_of(tmp_path / "poses", tmp_path, "--steps", 20, "--stride", 4, "--heading")
    engine = student_of(tmp_path)
    assert_served(engine, tmp_path, T=20, D=3)
    sampler, training = engine.card.ode, engine.card.training
    assert (sampler.method, sampler.schedule) == ("euler", (0.0, 0.8, 1.0))
    assert training["config"]["method"] == "direct"
    assert len(training["teacher"]["sha256"]) == 64


def test_a_real_drive_becomes_scenes(tmp_path: Path, shared_data: Callable[[str], Path]) -> None:
    """A drive in the plane, at the speeds and distances of a car."""
    scenes = data_of(shared_data("kitti_00_poses.txt"), tmp_path, "--stride", 50)
    assert scenes.limits.v_max > 10.0
    assert scenes.meta["robot_radius"] == RADIUS
    assert scenes.arrays["states"].shape[2:] == (45, 6)
