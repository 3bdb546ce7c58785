"""Bundles that come and go while the service runs.

folders     where bundles lie, and which models they hold
opening     the models with which a service starts
repository  load, unload, and what is known of every bundle
"""

from anchorflow_service.repository.folders import BundleFolders
from anchorflow_service.repository.opening import open_all
from anchorflow_service.repository.repository import LoadError, ModelState, Repository

__all__ = ["BundleFolders", "LoadError", "ModelState", "Repository", "open_all"]
