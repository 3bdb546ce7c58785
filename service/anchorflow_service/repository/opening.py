"""The models with which a service starts."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from anchorflow_service.bundle import BundleError
from anchorflow_service.planning import PlanningEngine
from anchorflow_service.repository.folders import BundleFolders, FoundBundle, RepositoryError

logger = logging.getLogger(__name__)


def open_all(
    folders: BundleFolders, open_engine: Callable[[Path], PlanningEngine]
) -> dict[str, PlanningEngine]:
    """An engine for every model, by name: those of single folders first, in their order.

    Of a model that lies in the repository in several versions, the newest one that is whole is
    opened; what is broken there is passed over, and the log says why.

    Raises:
        BundleError: the bundle of a single folder is broken.
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
