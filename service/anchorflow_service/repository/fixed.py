"""The repository of one worker among several: it can be looked at and not changed."""

from __future__ import annotations

from typing import NoReturn

from anchorflow_client.contract import ModelCard
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.repository.repository import Repository


class FixedRepository(Repository):
    """Refuses to load and to unload: the other workers would go on with the models they have."""

    def load(self, name: str, version: str | None = None) -> ModelCard:  # noqa: ARG002 - refused
        """Raises `InvalidRequest`."""
        _refuse()

    def unload(self, name: str) -> None:  # noqa: ARG002 - refused
        """Raises `InvalidRequest`."""
        _refuse()


def _refuse() -> NoReturn:
    raise InvalidRequest(
        "expected a service of one worker: this one has several, each with models of its own, "
        "which change when they are restarted"
    )
