"""The bundle reader: reads manifest.json and checks the bundle's files against it.

The signatures of the graphs are checked when `graphs.py` opens them, and how they fit together by
the engine's samplers and conditionings.
"""

from __future__ import annotations

import hashlib
import stat
from dataclasses import dataclass
from pathlib import Path

from anchorflow_client.contract import ModelCard
from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.bundle.manifest import FILE_NAME, Manifest, parse_manifest

DEFAULT_BUNDLE = Path(__file__).parents[1] / "bundles" / "default"
"""The bundle that ships inside the package."""


class BundleError(AnchorFlowError):
    """A bundle on disk is broken; the message names the file and says what is wrong with it.

    detail: a library's message, which may name paths and versions of this machine
    """

    def __init__(self, file: Path, wrong: str, detail: str = "") -> None:
        self.file = file
        self.wrong = wrong
        super().__init__(file, wrong, detail)  # pickle restores it from these

    def __str__(self) -> str:
        file, wrong, detail = self.args
        return f"{file}: {wrong}" + (f": {detail}" if detail else "")

    @property
    def reason(self) -> str:
        """Return the message without paths and details of this machine."""
        return f"{self.file.name}: {self.wrong}"


@dataclass(frozen=True)
class Bundle:
    """A bundle whose files match its manifest."""

    path: Path
    manifest: Manifest
    card: ModelCard

    def graph_path(self, role: str) -> Path:
        return self.path / self.manifest.graphs[role].file

    def file_path(self, role: str) -> Path:
        return self.path / self.manifest.files[role].file

    def fault(self, wrong: str) -> BundleError:
        """Return the error for something wrong in the manifest."""
        return BundleError(self.path / FILE_NAME, wrong)


def load_bundle(path: Path | str) -> Bundle:
    """Read a bundle's manifest and check its files against it. Raises `BundleError`."""
    folder = Path(path)
    manifest_path = folder / FILE_NAME
    data = read_file(manifest_path)
    try:
        manifest = parse_manifest(data)
    except ValueError as error:
        raise BundleError(manifest_path, str(error)) from error
    for entry in (*manifest.graphs.values(), *manifest.files.values()):
        _check_hash(folder / entry.file, entry.sha256)
    return Bundle(folder, manifest, manifest.card(sha256=hashlib.sha256(data).hexdigest()))


def read_file(path: Path) -> bytes:
    """Read a bundle's file. Raises `BundleError`, also for a pipe, which could block forever."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise BundleError(path, "cannot be read: not a regular file")
        return path.read_bytes()
    except OSError as error:
        raise BundleError(path, f"cannot be read: {error.strerror}") from error


def _check_hash(path: Path, expected: str) -> None:
    got = hashlib.sha256(read_file(path)).hexdigest()
    if got != expected:
        raise BundleError(path, f"its sha256 is {got}, the manifest says {expected}")
