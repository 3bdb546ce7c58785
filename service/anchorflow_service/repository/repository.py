"""The models at the start, and bundles that are loaded and unloaded while requests arrive."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from anchorflow_client.contract import ModelCard
from anchorflow_client.errors import AnchorFlowError, InvalidRequest, UnknownModel
from anchorflow_service.bundle import BundleError
from anchorflow_service.bundle.providers import ProviderError
from anchorflow_service.planning import EngineRegistry, PlanningEngine
from anchorflow_service.repository.folders import BundleFolders, FoundBundle, RepositoryError

READY, UNAVAILABLE = "READY", "UNAVAILABLE"
NOT_LOADED = "not loaded"

logger = logging.getLogger(__name__)


class LoadError(AnchorFlowError):
    """A bundle was refused; the previous one still serves. The message contains no path."""


def open_all(
    folders: BundleFolders, open_engine: Callable[[Path], PlanningEngine]
) -> dict[str, PlanningEngine]:
    """Open an engine for every model, by name: those of single folders first, in their order.

    Of a model with several versions in the repository, the newest valid one is opened; invalid
    bundles there are skipped, and the log says why.

    Raises:
        BundleError: the bundle of a single folder is invalid.
        RepositoryError: two single folders hold the same model, or there is nothing to serve.
    """
    engines: dict[str, PlanningEngine] = {}
    for path in folders.single:
        engine = open_engine(path)
        if engine.card.name in engines:
            raise RepositoryError(f"expected one bundle of {engine.card.name}, got two")
        engines[engine.card.name] = engine
    for found in folders.found():
        if found.path in folders.single or found.name in engines:
            continue
        if engine := _opened(found, open_engine):
            engines[found.name] = engine
    if not engines:
        raise RepositoryError("the repository holds no bundle that can be served")
    return engines


def _opened(
    found: FoundBundle, open_engine: Callable[[Path], PlanningEngine]
) -> PlanningEngine | None:
    try:
        if found.fault is not None:
            raise found.fault
        return open_engine(found.path)
    except BundleError as error:
        logger.warning("passed over: %s", error)
        return None


@dataclass(frozen=True)
class ModelState:
    """The state of one version of a model, in the terms of the protocol's extension."""

    name: str
    version: str
    state: str
    """READY or UNAVAILABLE."""
    reason: str
    """Why it is not ready, or why a newer bundle of the same version was refused."""


class Repository:
    """Loads and unloads the bundles of a service.

    A bundle is opened, checked and warmed up beside the one that serves, and replaces it in one
    step; if anything is wrong with it, the other stays. Methods block and are thread-safe; one
    bundle is loaded at a time.

    Args:
        engines: the engines that requests choose from.
        folders: the folders of bundles.
        open_engine: opens and warms up the bundle of a folder; `BundleError` if it is invalid.
    """

    def __init__(
        self,
        engines: EngineRegistry,
        folders: BundleFolders,
        open_engine: Callable[[Path], PlanningEngine],
    ) -> None:
        self._engines = engines
        self._folders = folders
        self._open_engine = open_engine
        self._loading = threading.Lock()
        self._faults: dict[tuple[str, str], str] = {}
        """The reason why the last load was refused, by model and version."""

    def load(self, name: str, version: str | None = None) -> ModelCard:
        """Read the bundle of a model, of that version or the newest, and serve it.

        Raises `UnknownModel` if no folder holds it, `LoadError` if it is invalid.
        """
        with self._loading:
            found = self._find(name, version)
            engine = self._open(found)
            self._engines.put(engine)
            self._faults.pop((name, found.version), None)
        logger.info("model %s %s is loaded", name, engine.card.version)
        return engine.card

    def unload(self, name: str) -> None:
        """Stop serving a model, but answer requests that chose it. Raises `UnknownModel`."""
        self._engines.remove(name)
        logger.info("model %s is unloaded", name)

    def index(self) -> list[ModelState]:
        """Return every version of every model that is in a folder or is served."""
        found = self._folders.found()
        unreadable = {(each.name, each.version): each.fault.reason for each in found if each.fault}
        faults = self._faults | unreadable
        served = [(card.name, card.version) for card in self._engines.cards()]
        known = dict.fromkeys([*((each.name, each.version) for each in found), *served])
        return [
            ModelState(*key, READY, faults.get(key, ""))
            if key in served
            else ModelState(*key, UNAVAILABLE, faults.get(key, NOT_LOADED))
            for key in known
        ]

    def _find(self, name: str, version: str | None) -> FoundBundle:
        try:
            found = self._folders.find(name, version)
        except BundleError as error:
            raise LoadError(error.reason) from error
        except RepositoryError as error:
            raise LoadError(str(error)) from error
        if found is None:
            which = name if version is None else f"{name} {version}"
            raise UnknownModel(f"expected a model of the repository, got {which!r}", "model")
        return found

    def _open(self, found: FoundBundle) -> PlanningEngine:
        try:
            engine = self._open_engine(found.path)
            card = engine.card
            if (card.name, card.version) != (found.name, found.version):
                raise BundleError(found.path, "it changed while it was read")
        except (BundleError, ProviderError) as error:
            logger.warning("model %s %s was not taken: %s", found.name, found.version, error)
            reason = error.reason if isinstance(error, BundleError) else str(error)
            self._faults[found.name, found.version] = reason
            raise LoadError(reason) from error
        return engine


class FixedRepository(Repository):
    """The repository of one worker among several: it can be listed but not changed."""

    def load(self, name: str, version: str | None = None) -> ModelCard:  # noqa: ARG002 - refused
        """Raises `InvalidRequest`."""
        _refuse_change()

    def unload(self, name: str) -> None:  # noqa: ARG002 - refused
        """Raises `InvalidRequest`."""
        _refuse_change()


def _refuse_change() -> NoReturn:
    raise InvalidRequest(
        "expected a service of one worker: this one has several, each with models of its own, "
        "which change when they are restarted"
    )
