"""Bundles that come and go while the service runs.

folders     where bundles lie, and which models they hold
opening     the models with which a service starts
repository  load, unload, and what is known of every bundle
fixed       one that is looked at alone
"""

from anchorflow_service.repository.fixed import FixedRepository
from anchorflow_service.repository.folders import BundleFolders
from anchorflow_service.repository.opening import open_all
from anchorflow_service.repository.repository import LoadError, ModelState, Repository

__all__ = ["BundleFolders", "FixedRepository", "LoadError", "ModelState", "Repository", "open_all"]
