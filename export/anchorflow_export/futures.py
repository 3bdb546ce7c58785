"""Add the network that predicts the others to a bundle, whose other graphs stay as they are."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from anchorflow_client.contract import TensorSpec
from anchorflow_client.contract.batch import FUTURE_PROBABILITIES, FUTURES
from anchorflow_export.bundle import into_place, write_graph
from anchorflow_export.parity import TOLERANCE, Difference, difference, within
from anchorflow_export.tracing import ExportError, random_tensor, trace
from anchorflow_models.futures import FuturesConfig, FuturesNetwork
from anchorflow_models.torch_graphs import Role, TorchGraphs
from anchorflow_service.bundle import Bundle, BundleError, load_bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.bundle.manifest import FILE_NAME, OTHERS
from anchorflow_service.engine import Engine

OTHERS_UNIT = (
    "-2, -1.5, -1, -0.5 and 0 s: x, y: m; heading: rad; velocity x, y: m/s; length, width: m; "
    "kind: 1 vehicle, 2 person, 3 cyclist, 0 nobody"
)
FARTHEST = 1000.0
SCENES = 3


def others_spec(config: FuturesConfig) -> TensorSpec:
    """Return the spec of the input `others`."""
    shape = ("B", config.others, config.times, 8)
    return TensorSpec(OTHERS, "float32", shape, OTHERS_UNIT, (-FARTHEST, FARTHEST), optional=True)


def futures_specs(config: FuturesConfig) -> tuple[TensorSpec, TensorSpec]:
    """Return the specs of the extras that a bundle gets."""
    shape = ("B", config.others, config.modes)
    return (
        TensorSpec(FUTURES, "float32", (*shape, config.num_steps, 3), "m, m, rad"),
        TensorSpec(FUTURE_PROBABILITIES, "float32", shape, range=(0.0, 1.0)),
    )


def add_futures(
    model: FuturesNetwork,
    path: Path,
    *,
    training: Mapping[str, Any],
    version: str | None = None,
    tolerance: float = TOLERANCE,
) -> tuple[Difference, ...]:
    """Put the graph `futures` into the bundle at a path, in place of one that is there already.

    training: provenance of the weights; version: of the bundle, None: as it is

    Returns the differences between ONNX and torch.

    Raises `BundleError` if there is no sound bundle at that path; `ExportError` if it has other
    inputs or times than the network, or ONNX and torch differ by more than the tolerance. The
    bundle stays what it was.
    """
    before, config = load_bundle(path), model.config
    manifest = before.manifest
    inputs = _inputs(before, config)
    asked, *others = inputs
    inputs = (replace(asked, shape=("B", "A", *asked.shape[2:])), *others)
    names = tuple(spec.name for spec in inputs)
    role = Role(model.eval(), FUTURES, inputs=names, outputs=(FUTURES, FUTURE_PROBABILITIES))
    extras = futures_specs(config)
    own = {spec.name for spec in extras}
    kept = [spec for spec in manifest.answer.extras if spec.name not in own]
    request = [spec for spec in manifest.request.inputs if spec.name != asked.name]
    with into_place(path) as folder:
        shutil.copytree(path, folder, dirs_exist_ok=True)
        traced = trace(role, inputs=inputs, outputs=role.outputs)
        graph = write_graph(traced, folder / f"{FUTURES}.onnx")
        changed = manifest.model_copy(
            update={
                "version": version or manifest.version,
                "request": manifest.request.model_copy(update={"inputs": (*request, asked)}),
                "answer": replace(manifest.answer, extras=(*kept, *extras)),
                "graphs": manifest.graphs | {FUTURES: graph},
                "training": {**manifest.training, FUTURES: dict(training)},
            }
        )
        (folder / FILE_NAME).write_bytes(changed.to_json())
        try:
            bundle = load_bundle(folder)
            Engine(bundle, threads=1)
        except BundleError as error:
            raise ExportError(f"expected a bundle that can be served, got {error}") from error
        return _proved(role, bundle, inputs, tolerance=tolerance)


def _inputs(bundle: Bundle, config: FuturesConfig) -> tuple[TensorSpec, ...]:
    """Return the specs of others, bev and ego_status; raise `ExportError` if they do not fit."""
    manifest, bev = bundle.manifest, config.bev
    given = {spec.name: spec for spec in manifest.request.inputs}
    shape = ("B", bev.channels, bev.rows, bev.columns)
    for name, wanted in (("bev", shape), ("ego_status", ("B", 8))):
        got = [*given[name].shape] if name in given else "none"
        if got != [*wanted]:
            raise ExportError(f"{name}: expected an input {[*wanted]}, got {got}")
    time, wanted = manifest.time, (config.num_steps, config.dt, config.dt)
    if (time.steps, time.first_s, time.dt) != wanted:
        got = (time.steps, time.first_s, time.dt)
        raise ExportError(f"time: expected steps, first_s and dt {wanted}, got {got}")
    return others_spec(config), given["bev"], given["ego_status"]


def _proved(
    role: Role, bundle: Bundle, inputs: tuple[TensorSpec, ...], *, tolerance: float
) -> tuple[Difference, ...]:
    """Compare the graph with torch on random scenes, in which some rows are unused."""
    arrays = {spec.name: random_tensor(spec, {"B": SCENES}).numpy() for spec in inputs}
    rng, shape = np.random.default_rng(0), arrays[OTHERS].shape
    others = rng.uniform(-1, 1, shape) * [30.0, 30.0, 3.0, 9.0, 9.0, 0, 0, 0]
    others[..., 5:] = [4.6, 1.9, 0.0]
    others[..., 7] = rng.integers(0, 4, shape[:-1])
    arrays[OTHERS] = others.astype(np.float32)
    wanted = TorchGraphs({FUTURES: role}).run(FUTURES, arrays)
    got = OnnxGraphs(bundle).run(FUTURES, arrays)
    differences = [difference(f"{FUTURES}, {name}", got[name], wanted[name]) for name in wanted]
    return within(differences, tolerance)
