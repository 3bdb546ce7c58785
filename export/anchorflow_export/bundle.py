"""From a torch model to a bundle on disk: traced, written, proved, and only then put in place."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from anchorflow_client.contract import MapSpec, SamplerSpec, TensorSpec
from anchorflow_export.errors import ExportError
from anchorflow_export.graphs import F32, PRIOR_BASIS, PRIOR_MEAN, FlowModel, unit_of
from anchorflow_export.parity import TOLERANCE, Difference, prove_parity
from anchorflow_export.roles import TracedGraph, trace_roles
from anchorflow_export.tracing import OPSET
from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.manifest import (
    FILE_NAME,
    FORMAT,
    Adjustable,
    GraphEntry,
    LimitsEntry,
    Manifest,
    PriorEntry,
    RefineEntry,
    SamplerEntry,
)


@dataclass(frozen=True, kw_only=True)
class BundleDescription:
    """What a manifest says beside its graphs.

    T: time steps of an anchor; D: dimensions of a position
    map: the grid that the model was trained on; its channels are those of the cost_map input
    sampler, refine: what a request that leaves them open gets
    adjustable: limits that a request may change
    training: provenance of the weights; quality: the judge's table, where it is known already
    """

    name: str
    version: str
    planner: str
    T: int
    D: int
    limits: LimitsEntry
    map: MapSpec
    sampler: SamplerSpec
    refine: RefineEntry
    adjustable: tuple[Adjustable, ...] = ("robot_radius",)
    training: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] = field(default_factory=dict)


def export_bundle(
    model: FlowModel, description: BundleDescription, *, out: Path, tolerance: float = TOLERANCE
) -> tuple[Difference, ...]:
    """Write a torch flow model as the bundle `out`, in the place of a bundle that is there.

    Returns how far ONNX and torch are apart, for every graph and for whole samples.

    Raises:
        ExportError: the model cannot be traced, ONNX and torch differ by more than the tolerance,
            or `out` is something else than a bundle. Nothing is left behind.
    """
    with into_place(out) as folder:
        traced = trace_roles(
            model, T=description.T, D=description.D, channels=description.map.channels
        )
        graphs = {role: _write(graph, folder / f"{role}.onnx") for role, graph in traced.items()}
        (folder / FILE_NAME).write_bytes(_manifest(description, graphs).to_json())
        return prove_parity(model, load_bundle(folder), tolerance=tolerance)


def record_quality(bundle: Path, quality: Mapping[str, Any]) -> None:
    """Put the quality that the judge measured on a bundle into its manifest.

    Raises:
        BundleError: there is no sound bundle at that path.
    """
    manifest = load_bundle(bundle).manifest.model_copy(update={"quality": dict(quality)})
    scratch = bundle / f".{FILE_NAME}"
    scratch.write_bytes(manifest.to_json())
    scratch.replace(bundle / FILE_NAME)


def _write(graph: TracedGraph, path: Path) -> GraphEntry:
    data = graph.model.SerializeToString(deterministic=True)
    path.write_bytes(data)
    return GraphEntry(
        file=path.name,
        sha256=hashlib.sha256(data).hexdigest(),
        opset=OPSET,
        inputs=graph.inputs,
        outputs=graph.outputs,
    )


def _manifest(description: BundleDescription, graphs: dict[str, GraphEntry]) -> Manifest:
    sampler = description.sampler
    return Manifest(
        format=FORMAT,
        name=description.name,
        version=description.version,
        planner=description.planner,
        inputs=graphs["encode"].inputs,
        outputs=_anchor_specs(description),
        graphs=graphs,
        sampler=SamplerEntry(
            kind="ode",
            method=sampler.method,
            schedule=sampler.schedule,
            prior=PriorEntry(mean=PRIOR_MEAN, basis=PRIOR_BASIS),
        ),
        refine=description.refine,
        T=description.T,
        D=description.D,
        dt=description.limits.horizon_s / (description.T - 1),
        limits=description.limits,
        adjustable=description.adjustable,
        map=description.map,
        training=dict(description.training),
        quality=dict(description.quality),
    )


def _anchor_specs(description: BundleDescription) -> tuple[TensorSpec, ...]:
    """What the engine answers."""
    limits, D = description.limits, description.D
    fields = {
        "positions": ("m", None),
        "velocities": ("m/s", (-limits.v_max, limits.v_max)),
        "accelerations": ("m/s^2", (-limits.a_max, limits.a_max)),
    }
    shape = ("B", "N", description.T, D)
    return tuple(
        # The limits are planar: of a heading's rate they say nothing.
        TensorSpec(name, F32, shape, unit_of(unit, D), limit if D == 2 else None)
        for name, (unit, limit) in fields.items()
    )


@contextmanager
def into_place(out: Path) -> Iterator[Path]:
    """A new folder that becomes `out` where the block succeeds, and vanishes where it fails."""
    if out.exists() and not (out / FILE_NAME).is_file():
        raise ExportError(f"{out} is there already and is not a bundle")
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as scratch:
        folder = Path(scratch, "new")
        folder.mkdir()
        yield folder
        if out.exists():
            out.rename(Path(scratch, "old"))
        folder.rename(out)
