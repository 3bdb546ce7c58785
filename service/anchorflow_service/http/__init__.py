"""The HTTP endpoints: `POST /anchors` in JSON and in binary, health, and the models' cards."""

from anchorflow_service.http.app import create_app

__all__ = ["create_app"]
