"""Bundles that come and go while the service runs.

folders     the folders of bundles, and the models in them
repository  the models at the start, loading and unloading
"""

from anchorflow_service.repository.folders import BundleFolders, RepositoryError
from anchorflow_service.repository.repository import (
    READY,
    UNAVAILABLE,
    FixedRepository,
    LoadError,
    ModelState,
    Repository,
    open_all,
)

__all__ = [
    "READY",
    "UNAVAILABLE",
    "BundleFolders",
    "FixedRepository",
    "LoadError",
    "ModelState",
    "Repository",
    "RepositoryError",
    "open_all",
]
