"""From a torch model to a bundle on disk: traced, written, proved, and only then put in place."""

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
from anchorflow_export.adapter import PlannerAdapter, PlannerParts, TracedGraph
from anchorflow_export.errors import ExportError
from anchorflow_export.parity import TOLERANCE, Difference, prove_parity
from anchorflow_export.tracing import OPSET
from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.bundle.manifest import (
    FILE_NAME,
    FORMAT,
    FileEntry,
    GraphEntry,
    Manifest,
    RequestEntry,
)
from anchorflow_service.engine import Engine


@dataclass(frozen=True, kw_only=True)
class BundleDescription:
    """What a manifest says of a bundle that its planner does not.

    planner: its name in the registry of planners
    training: provenance of the weights; quality: the judge's table, where it is known already
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
    """Write a torch planner as the bundle `out`, in the place of a bundle that is there.

    Returns how far ONNX and torch are apart, for every graph and for whole samples.

    Raises:
        ExportError: the model cannot be traced, its parts make no manifest, ONNX and torch differ
            by more than the tolerance, the service refuses the bundle, or `out` is something else
            than a bundle or cannot be written. Nothing is left behind.
    """
    with into_place(out) as folder:
        parts = adapter.parts
        manifest = _manifest(parts, description)  # Its faults are told before a minute of tracing.
        graphs = {
            role: _write(graph, folder / f"{role}.onnx") for role, graph in adapter.trace().items()
        }
        files = {
            role: _write_file(folder / name, data) for role, (name, data) in parts.files.items()
        }
        whole = manifest.model_copy(update={"graphs": graphs, "files": files})
        (folder / FILE_NAME).write_bytes(whole.to_json())
        try:
            bundle = load_bundle(folder)
            differences = prove_parity(adapter, bundle, tolerance=tolerance)
            Engine(bundle, threads=1)
        except BundleError as error:
            raise ExportError(f"expected a bundle that can be served, got {error}") from error
        return differences


def record_quality(bundle: Path, quality: Mapping[str, Any]) -> None:
    """Put the quality that the judge measured on a bundle into its manifest.

    Raises:
        BundleError: there is no sound bundle at that path, or no place to write.
    """
    manifest = load_bundle(bundle).manifest.model_copy(update={"quality": dict(quality)})
    scratch = bundle / f".{FILE_NAME}"
    try:
        scratch.write_bytes(manifest.to_json())
        scratch.replace(bundle / FILE_NAME)
    except OSError as error:
        raise BundleError(bundle, f"its manifest cannot be written: {error}") from error


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


def _write_file(path: Path, data: bytes) -> FileEntry:
    path.write_bytes(data)
    return FileEntry(file=path.name, sha256=hashlib.sha256(data).hexdigest())


def _manifest(parts: PlannerParts, description: BundleDescription) -> Manifest:
    """As it is before there are graphs and files."""
    try:
        anchors_key(description.name)  # Under which the bundle is asked over zenoh.
    except InvalidRequest as error:
        raise ExportError(f"name: {error}") from error
    try:
        return Manifest(
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
    except ValueError as error:
        # Of the first fault, without the whole manifest that pydantic puts after it.
        said = " ".join(str(error).partition("[type=")[0].split())
        raise ExportError(f"manifest of {description.name}: {said}") from error


@contextmanager
def into_place(out: Path) -> Iterator[Path]:
    """A new folder that becomes `out` where the block succeeds, and vanishes where it fails.

    Raises:
        ExportError: `out` is no bundle, cannot be replaced or cannot be written.
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
