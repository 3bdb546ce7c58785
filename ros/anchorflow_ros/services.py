"""The client that the parameter `service` names."""

from __future__ import annotations

from anchorflow_client import AnchorClient
from anchorflow_client.base_client import BaseClient
from anchorflow_client.errors import AnchorFlowError
from anchorflow_ros.parameters import IN_PROCESS, Settings


class ServiceError(AnchorFlowError):
    """The parameter `service` names none that this installation can reach."""


def client_of(settings: Settings) -> BaseClient:
    """Return a service's client; one of this process loads its bundle. Raises `ServiceError`."""
    where: str = settings["service"]
    timeout_s = settings["service.max_age_s"]
    if where == IN_PROCESS:
        return _in_process(settings["service.bundle"])
    if where.startswith(("http://", "https://")):
        return AnchorClient(where, timeout_s=timeout_s)
    try:
        from anchorflow_client.zenoh_client import ZenohAnchorClient
    except ImportError as error:
        raise ServiceError(
            f"service: expected '{IN_PROCESS}', a URL or, with the extra [zenoh] installed, a "
            f"zenoh endpoint; got {where!r}"
        ) from error
    return ZenohAnchorClient(where, timeout_s=timeout_s)


def _in_process(bundle: str) -> BaseClient:
    try:
        from anchorflow_service.bundle import DEFAULT_BUNDLE
        from anchorflow_service.local import LocalClient
    except ImportError as error:
        raise ServiceError(
            f"service: '{IN_PROCESS}' needs the extra [service]; install it, or name the URL of a "
            "service"
        ) from error
    return LocalClient.of(bundle or DEFAULT_BUNDLE)
