"""The folders that hold bundles: single bundles, and a repository of several.

A repository is a folder of bundles, `FOLDER/flowmp/manifest.json`, or of bundles by version,
`FOLDER/flowmp/0.2.0/manifest.json`. A bundle's manifest names its model; names of folders do not
matter. Every call searches the folders again, so a bundle that was just copied there is found.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.bundle import BundleError
from anchorflow_service.bundle.manifest import FILE_NAME, parse_manifest
from anchorflow_service.bundle.reader import read_file


class RepositoryError(AnchorFlowError):
    """The folders hold no bundle, or two of the same model and version."""


@dataclass(frozen=True)
class FoundBundle:
    """A folder with a manifest; its graphs have not been read."""

    path: Path
    name: str
    """The model's name. If the manifest is invalid, that of the versions beside it, or the
    folder's."""
    version: str
    """If the manifest is invalid, the folder's name if it lies among versions, or empty."""
    fault: BundleError | None = None
    """Why the manifest is invalid."""


class BundleFolders:
    """The bundles of single folders and of a repository. Raises `RepositoryError`."""

    def __init__(self, bundles: Sequence[Path] = (), *, repository: Path | None = None) -> None:
        if repository is not None and not repository.is_dir():
            raise RepositoryError(f"{repository}: expected a folder of bundles, found none")
        self.single = tuple(bundles)
        self._repository = repository

    def __str__(self) -> str:
        repository = [] if self._repository is None else [f"repository {self._repository}"]
        return ", ".join([*(f"bundle {path}" for path in self.single), *repository])

    def found(self) -> list[FoundBundle]:
        """Return all bundles, valid or not, the newest version of each model first."""
        found = self._by_model([_look_at(path) for path in self._paths()])
        found.sort(key=lambda bundle: _version_order(bundle.version), reverse=True)
        found.sort(key=lambda bundle: bundle.name)
        return found

    def find(self, name: str, version: str | None = None) -> FoundBundle | None:
        """Return the bundle of a model, of that version or the newest; None if there is none.

        Raises `RepositoryError` if two folders hold that version, `BundleError` if it is invalid.
        """
        same_name = [bundle for bundle in self.found() if bundle.name == name]
        matching = [bundle for bundle in same_name if version in (None, bundle.version)]
        # An invalid manifest outside a folder of versions may be of any version.
        matching += [bundle for bundle in same_name if bundle.fault and not bundle.version]
        if not matching:
            return None
        first = matching[0]
        if first.fault is not None:
            raise first.fault
        if sum(other.version == first.version for other in matching) > 1:
            twice = f"{name} {first.version}"
            raise RepositoryError(f"expected one bundle of {twice}, found it in two folders")
        return first

    def _by_model(self, found: list[FoundBundle]) -> list[FoundBundle]:
        """Name an invalid bundle among versions after the model beside it."""
        names: dict[Path, set[str]] = {}
        for bundle in found:
            if bundle.fault is None:
                names.setdefault(bundle.path.parent, set()).add(bundle.name)

        def named(bundle: FoundBundle) -> FoundBundle:
            folder = bundle.path.parent
            if bundle.fault is None or folder.parent != self._repository:
                return bundle
            beside = names.get(folder, set())
            name = next(iter(beside)) if len(beside) == 1 else folder.name
            return replace(bundle, name=name, version=bundle.path.name)

        return [named(bundle) for bundle in found]

    def _paths(self) -> Iterator[Path]:
        """Yield each folder once; a single one may be in the repository too."""
        paths = [*self.single]
        if self._repository is not None:
            # A folder whose name begins with a dot is being written by an export.
            for pattern in (f"[!.]*/{FILE_NAME}", f"[!.]*/[!.]*/{FILE_NAME}"):
                paths += [manifest.parent for manifest in sorted(self._repository.glob(pattern))]
        return iter({path.resolve(): path for path in paths}.values())


def _look_at(path: Path) -> FoundBundle:
    file = path / FILE_NAME
    try:
        manifest = parse_manifest(read_file(file))
    except BundleError as error:
        fault = error
    except ValueError as error:
        fault = BundleError(file, str(error))
    else:
        return FoundBundle(path, manifest.name, manifest.version)
    return FoundBundle(path, path.name, "", fault)


def _version_order(version: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts 0.10.0 behind 0.9.1, and 1.0.0 behind 1.0.0-rc1."""
    return [*map(_part_order, re.findall(r"[0-9]+|[a-zA-Z]+", version)), (1, 0, "")]


def _part_order(part: str) -> tuple[int, int, str]:
    """Sort words below the end of a version and numbers, of any length, above it."""
    digits = part.lstrip("0")
    return (2, len(digits), digits) if part.isdecimal() else (0, 0, part)
