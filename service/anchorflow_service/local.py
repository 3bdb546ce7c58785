"""A client without a server: it runs a bundle in this process."""

from __future__ import annotations

from pathlib import Path

from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard, resolve_for_card
from anchorflow_client.errors import InternalError
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine


class LocalClient(BaseClient):
    """Plans on the caller's thread. It decodes no images: an `EncodedImage` is refused.

    with LocalClient.of(bundle) as client:
        anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    @classmethod
    def of(cls, bundle: Path | str = DEFAULT_BUNDLE, *, threads: int | None = None) -> LocalClient:
        """Load a bundle's folder. Raises `BundleError`."""
        return cls(Engine(load_bundle(bundle), threads=threads))

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        batch = self.engine.plan(resolve_for_card(request, self.engine.card))
        if not batch.is_finite:
            raise InternalError("the answer holds numbers that are not finite")
        return batch

    def models(self) -> tuple[ModelCard, ...]:
        return (self.engine.card,)

    def live(self) -> bool:
        return True

    def ready(self) -> bool:
        return True

    def close(self) -> None:
        pass
