"""Export a torch model to a bundle on disk: trace, write and prove it, then put it in place."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from anchorflow_client.errors import InvalidRequest
from anchorflow_client.zenoh_messages import anchors_key
from anchorflow_export.adapter import PlannerAdapter, PlannerParts
from anchorflow_export.parity import TOLERANCE, Difference, prove_parity
from anchorflow_export.tracing import OPSET, ExportError, TracedGraph
from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.bundle.manifest import (
    FILE_NAME,
    FORMAT,
    FileEntry,
    GraphEntry,
    Manifest,
    RequestEntry,
    parse_manifest,
)


@dataclass(frozen=True, kw_only=True)
class BundleDescription:
    """The part of a manifest that the planner does not know.

    planner: its name in the registry of planners
    training: provenance of the weights; quality: the judge's table, if it is known already
    """

    name: str
    version: str
    planner: str
    training: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] = field(default_factory=dict)


def export_bundle(
    adapter: PlannerAdapter,
    description: BundleDescription,
    *,
    out: Path,
    tolerance: float = TOLERANCE,
) -> tuple[Difference, ...]:
    """Write a torch planner as the bundle `out`, which may replace a bundle.

    Returns the differences between ONNX and torch, for every graph and for whole samples.

    Raises `ExportError` if the model cannot be traced, its parts make no manifest, ONNX and torch
    differ by more than the tolerance, the service refuses the bundle, or `out` is not a bundle or
    cannot be written. Nothing is left behind.
    """
    with into_place(out) as folder:
        parts = adapter.parts
        manifest = _manifest(parts, description)  # Refuse it before a minute of tracing.
        graphs: dict[str, GraphEntry] = {}
        for role in adapter.roles:  # one in memory at a time: a large one takes gigabytes
            graphs[role] = write_graph(adapter.trace(role, graphs), folder / f"{role}.onnx")
        files = {
            role: _write_file(folder / name, data) for role, (name, data) in parts.files.items()
        }
        whole = manifest.model_copy(update={"graphs": graphs, "files": files})
        (folder / FILE_NAME).write_bytes(whole.to_json())
        try:
            bundle = load_bundle(folder)
            return prove_parity(adapter, bundle, tolerance=tolerance)
        except BundleError as error:
            raise ExportError(f"expected a bundle that can be served, got {error}") from error


def record_quality(bundle: Path, quality: Mapping[str, Any]) -> None:
    """Write the quality that the judge measured into a bundle's manifest.

    Raises `BundleError` if there is no sound bundle at that path, or it cannot be written.
    """
    manifest = load_bundle(bundle).manifest.model_copy(update={"quality": dict(quality)})
    scratch = bundle / f".{FILE_NAME}"
    try:
        scratch.write_bytes(manifest.to_json())
        scratch.replace(bundle / FILE_NAME)
    except OSError as error:
        raise BundleError(bundle, f"its manifest cannot be written: {error}") from error


def write_graph(graph: TracedGraph, path: Path) -> GraphEntry:
    """Write a graph as a file, and return its entry in the manifest."""
    data = graph.model.SerializeToString(deterministic=True)
    path.write_bytes(data)
    return GraphEntry(
        file=path.name,
        sha256=hashlib.sha256(data).hexdigest(),
        opset=OPSET,
        inputs=graph.inputs,
        outputs=graph.outputs,
    )


def _write_file(path: Path, data: bytes) -> FileEntry:
    path.write_bytes(data)
    return FileEntry(file=path.name, sha256=hashlib.sha256(data).hexdigest())


def _manifest(parts: PlannerParts, description: BundleDescription) -> Manifest:
    """Return the manifest without graphs and files."""
    try:
        anchors_key(description.name)  # Zenoh's key of the bundle.
    except InvalidRequest as error:
        raise ExportError(f"name: {error}") from error
    try:
        manifest = Manifest(
            format=FORMAT,
            name=description.name,
            version=description.version,
            planner=description.planner,
            request=RequestEntry(inputs=parts.inputs),
            conditioning=parts.conditioning,
            sampler=parts.sampler,
            finish=parts.finish,
            time=parts.time,
            answer=parts.answer,
            graphs={},
            training=dict(description.training),
            quality=dict(description.quality),
        )
        return parse_manifest(manifest.to_json())  # which checks the numbers of the parts too
    except ValueError as error:
        # The first fault, without the whole manifest that pydantic appends.
        said = " ".join(str(error).partition("[type=")[0].split())
        raise ExportError(f"manifest of {description.name}: {said}") from error


@contextmanager
def into_place(out: Path) -> Iterator[Path]:
    """Yield a new folder that becomes `out` if the block succeeds, and vanishes if it fails.

    Raises `ExportError` if `out` is not a bundle, cannot be replaced or cannot be written.
    """
    out = out.absolute()  # the parent of "." would be "." again
    try:
        if out.exists() and not (out / FILE_NAME).is_file():
            raise ExportError(f"{out} is there already and is not a bundle")
        if out.is_mount() or Path.cwd().is_relative_to(out.resolve()):
            raise ExportError(
                f"{out}: expected a folder that can be replaced, got a mount point or the working "
                "directory"
            )
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as scratch:
            folder = Path(scratch, "new")
            folder.mkdir()
            yield folder
            if out.exists():
                out.rename(Path(scratch, "old"))
            folder.rename(out)
    except OSError as error:
        raise ExportError(f"{out}: expected a place to write a bundle ({error})") from error
