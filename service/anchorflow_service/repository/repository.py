"""The repository: bundles loaded and unloaded while requests come."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from anchorflow_client.contract import ModelCard
from anchorflow_client.errors import AnchorFlowError, UnknownModel
from anchorflow_service.bundle import BundleError
from anchorflow_service.bundle.providers import ProviderError
from anchorflow_service.planning import EngineRegistry, PlanningEngine
from anchorflow_service.repository.folders import BundleFolders, FoundBundle, RepositoryError

READY, UNAVAILABLE = "READY", "UNAVAILABLE"
NOT_LOADED = "not loaded"

logger = logging.getLogger(__name__)


class LoadError(AnchorFlowError):
    """A bundle was not taken; what served before still serves. The message tells no path."""


@dataclass(frozen=True)
class ModelState:
    """What is known of one version of a model, in the words of the protocol's extension."""

    name: str
    version: str
    state: str
    """READY or UNAVAILABLE."""
    reason: str
    """Why it is not ready, or why the newer bundle of the same version was not taken."""


class Repository:
    """Loads bundles into the engines of a service, and takes them out.

    A bundle is opened, checked and warmed up beside the one that serves, and takes its place in
    one step; where anything is wrong with it, the other stays. Blocking, and safe to call from
    several threads; one bundle is loaded at a time.

    Args:
        engines: that requests choose from.
        folders: where bundles lie.
        open_engine: opens and warms up the bundle of a folder; `BundleError` where it is broken.
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
        """By model and version: why it was not taken when it was loaded last."""

    def load(self, name: str, version: str | None = None) -> ModelCard:
        """Read the bundle of a model from its folder, and serve it from now on.

        version: None: the newest there is

        Raises:
            UnknownModel: no folder holds that model, or that version of it.
            LoadError: its bundle is broken.
        """
        with self._loading:
            found = self._find(name, version)
            engine = self._open(found)
            self._engines.put(engine)
            self._faults.pop((name, found.version), None)
        logger.info("model %s %s is loaded", name, engine.card.version)
        return engine.card

    def unload(self, name: str) -> None:
        """Serve a model no longer; requests that have been taken are still answered.

        Raises:
            UnknownModel: it is not served.
        """
        self._engines.remove(name)
        logger.info("model %s is unloaded", name)

    def index(self) -> list[ModelState]:
        """Every version of every model that lies in a folder or is served."""
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
