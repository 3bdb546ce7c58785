"""The service on a zenoh network: one replica, which answers from the same queue as HTTP."""

from anchorflow_service.zenoh_endpoint.endpoint import ZenohEndpoint

__all__ = ["ZenohEndpoint"]
