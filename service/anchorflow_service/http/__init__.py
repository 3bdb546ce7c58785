"""The HTTP endpoints: `POST /anchors` in JSON, health, and the cards of what is served."""

from anchorflow_service.http.app import create_app
from anchorflow_service.http.engines import Engine
from anchorflow_service.http.limits import Limits

__all__ = ["Engine", "Limits", "create_app"]
