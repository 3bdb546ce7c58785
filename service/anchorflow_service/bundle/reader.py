"""The bundle reader: a folder of manifest.json and ONNX graphs, checked before it serves.

What the graphs themselves say of their inputs and outputs is checked where they are opened, in
`graph.py`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from anchorflow_client.contract import ModelCard
from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.bundle.manifest import FILE_NAME, GraphEntry, Manifest, parse_manifest
from anchorflow_service.engine.conditioning.cost_map import SCENE_INPUTS

DEFAULT_BUNDLE = Path(__file__).parents[1] / "bundles" / "default"
"""The bundle that ships inside the package."""

# What each role of an "ode" bundle is fed besides the outputs of encode.
OWN_INPUTS = {"modulate": ("times",), "field": ("x_t", "modulation")}
OWN_OUTPUTS = {"modulate": ("modulation",), "field": ("dx_t",)}


class BundleError(AnchorFlowError):
    """A bundle on disk is broken; the message names the file and says what is wrong with it.

    detail: what a library said, which may name paths and versions of this machine
    """

    def __init__(self, file: Path, wrong: str, detail: str = "") -> None:
        self.file = file
        self.wrong = wrong
        super().__init__(f"{file}: {wrong}" + (f": {detail}" if detail else ""))

    @property
    def reason(self) -> str:
        """The message without what only this machine's owner should read."""
        return f"{self.file.name}: {self.wrong}"


@dataclass(frozen=True)
class Bundle:
    """A bundle whose files are what its manifest says."""

    path: Path
    manifest: Manifest
    card: ModelCard

    def graph_path(self, role: str) -> Path:
        return self.path / self.manifest.graphs[role].file


def load_bundle(path: Path | str) -> Bundle:
    """Read a bundle's manifest and check its files against it.

    Raises:
        BundleError: the manifest is missing or wrong, a graph file is missing or is not the one
            that was exported, or the graphs cannot be wired together.
    """
    folder = Path(path)
    manifest_path = folder / FILE_NAME
    data = _read(manifest_path)
    try:
        manifest = parse_manifest(data)
    except ValueError as error:
        raise BundleError(manifest_path, str(error)) from error
    if wrong := next(_wiring_faults(manifest), None):
        raise BundleError(manifest_path, wrong)
    for entry in manifest.graphs.values():
        _check_hash(folder / entry.file, entry.sha256)
    return Bundle(folder, manifest, manifest.card(sha256=hashlib.sha256(data).hexdigest()))


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BundleError(path, f"cannot be read: {error.strerror}") from error


def _check_hash(path: Path, expected: str) -> None:
    got = hashlib.sha256(_read(path)).hexdigest()
    if got != expected:
        raise BundleError(path, f"its sha256 is {got}, the manifest says {expected}")


def _wiring_faults(manifest: Manifest) -> Iterator[str]:
    """What keeps the graphs of an "ode" bundle from being wired together by name."""
    if manifest.sampler.kind != "ode":
        yield f"sampler.kind {manifest.sampler.kind!r} is not supported by this version, ode is"
        return
    if missing := {"encode", *OWN_INPUTS} - set(manifest.graphs):
        yield f"graphs: an ode bundle needs the role {', '.join(sorted(missing))}"
        return
    encode = manifest.graphs["encode"]
    if encode.inputs != manifest.inputs:
        yield "inputs: they differ from those of graphs.encode"
    yield from _unknown("graphs.encode.inputs", encode.input_names, SCENE_INPUTS)
    for role, own in OWN_INPUTS.items():
        yield from _graph_faults(role, manifest.graphs[role], (*own, *encode.output_names))
    if prior := manifest.sampler.prior:
        yield from _unknown("sampler.prior", (prior.mean, prior.basis), encode.output_names)


def _graph_faults(role: str, graph: GraphEntry, known: tuple[str, ...]) -> Iterator[str]:
    yield from _unknown(f"graphs.{role}.inputs", graph.input_names, known)
    yield from _unknown(f"graphs.{role}.inputs", OWN_INPUTS[role], graph.input_names)
    if graph.output_names != OWN_OUTPUTS[role]:
        names = ", ".join(graph.output_names)
        yield f"graphs.{role}.outputs: expected {OWN_OUTPUTS[role][0]}, got {names}"


def _unknown(where: str, names: tuple[str, ...], known: tuple[str, ...]) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield f"{where}: {name!r} is not one of {', '.join(known)}"
