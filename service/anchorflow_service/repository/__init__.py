"""Bundles that come and go while the service runs.

folders     the folders of bundles, and the models in them
repository  the models at the start, loading and unloading
"""

from anchorflow_service.repository.folders import (
    BundleFolders as BundleFolders,
    RepositoryError as RepositoryError,
)
from anchorflow_service.repository.repository import (
    READY as READY,
    UNAVAILABLE as UNAVAILABLE,
    FixedRepository as FixedRepository,
    LoadError as LoadError,
    ModelState as ModelState,
    Repository as Repository,
    open_all as open_all,
)
