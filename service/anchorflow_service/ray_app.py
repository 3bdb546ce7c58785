"""The service on Ray Serve: replicas that come and go with the load, behind one address.

    serve run anchorflow_service.ray_app:app max_replicas=8 cpus=2

The HTTP contract is that of `anchorflow serve`, and so is a replica's queue; Ray's proxy routes.
`zenoh=tcp/HOST:7447` puts every replica on a zenoh network as well, each under keys of its own.
"""

# Not `from __future__ import annotations`: Ray's application builder makes `RaySettings` of the
# command's words only where the annotation of `app` is the class itself.

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI
from pydantic import BaseModel, ConfigDict, Field
from ray import serve  # pyright: ignore[reportMissingImports] - an extra that not every venv has

from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.http.tokens import TokenFile
from anchorflow_service.planning import PlanningService, ServiceLimits

if TYPE_CHECKING:
    from anchorflow_service.zenoh_endpoint import ZenohEndpoint


class RaySettings(BaseModel):
    """What `serve run … NAME=VALUE` may set."""

    model_config = ConfigDict(extra="forbid")

    bundle: Path = DEFAULT_BUNDLE
    """Folder of the bundle, on every node."""
    provider: str = "cpu"
    tokens: Path | None = None
    """File of bearer tokens, on every node; None: no token is required."""
    zenoh: str | None = None
    """Endpoint of a zenoh router to connect to."""
    cpus: int = Field(default=1, ge=1)
    """CPUs that Ray reserves for a replica, and threads of its engine."""
    gpus: float = Field(default=0.0, ge=0)
    min_replicas: int = Field(default=1, ge=0)
    max_replicas: int = Field(default=4, ge=1)
    target_requests: float = Field(default=2.0, gt=0)
    """Running in a replica, on average: with more of them, Ray starts another."""
    max_batch: int = Field(default=8, ge=1)
    batch_wait_ms: float = Field(default=0.0, ge=0)

    def limits(self) -> ServiceLimits:
        """The bounds of a replica."""
        return ServiceLimits(
            max_batch=self.max_batch, batch_wait_ms=self.batch_wait_ms, threads=self.cpus
        )


def app(settings: RaySettings) -> Any:
    """The Ray Serve application."""

    def replica() -> FastAPI:
        return build_replica(settings)

    limits = settings.limits()
    deployment = serve.deployment(
        serve.ingress(replica)(),
        name="anchors",
        ray_actor_options={"num_cpus": settings.cpus, "num_gpus": settings.gpus},
        # Its own queue refuses in the contract's words, so Ray hands over more than may wait there.
        max_ongoing_requests=2 * (limits.max_batch + limits.max_waiting),
        autoscaling_config={
            "min_replicas": settings.min_replicas,
            "max_replicas": settings.max_replicas,
            "target_ongoing_requests": settings.target_requests,
        },
    )
    return deployment.bind()


def build_replica(settings: RaySettings) -> FastAPI:
    """What runs in a replica. Raises `AnchorFlowError` where the bundle or the tokens are bad."""
    bundle = load_bundle(settings.bundle)
    engine = Engine(bundle, threads=settings.cpus, provider=settings.provider)
    name = engine.card.name
    service = PlanningService({name: engine}, default=name, limits=settings.limits())
    endpoints = [] if settings.zenoh is None else [_zenoh_endpoint(service, settings.zenoh)]
    tokens = None if settings.tokens is None else TokenFile(settings.tokens)
    return create_app(service, endpoints=endpoints, tokens=tokens)


def _zenoh_endpoint(service: PlanningService, router: str) -> "ZenohEndpoint":
    # Only here, because zenoh is an extra too.
    from anchorflow_client.zenoh_client import ZenohSettings
    from anchorflow_client.zenoh_client.session import open_session
    from anchorflow_service.zenoh_endpoint import ZenohEndpoint

    session = open_session(ZenohSettings(mode="client", connect=(router,)), wait_s=5.0)
    return ZenohEndpoint(service, session)
