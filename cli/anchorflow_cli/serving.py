"""`anchorflow serve`: from what was chosen to an application that can be served."""

from __future__ import annotations

import gc
import logging
import socket
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from fastapi import FastAPI
from starlette.middleware import Middleware

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.listening import url_of
from anchorflow_cli.model_options import described, folders_of
from anchorflow_cli.serve_options import LogFormat, LogLevel, Provider, TlsFiles
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import Draining
from anchorflow_service.http.tokens import TokenFile
from anchorflow_service.observability.metrics import reserve_shared_files
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_service.repository import (
    BundleFolders,
    FixedRepository,
    Repository,
    open_all,
)
from anchorflow_service.repository.folders import RepositoryError
from anchorflow_trajectory.cores import usable_cores

if TYPE_CHECKING:
    from anchorflow_cli.zenoh_options import ZenohChoice
    from anchorflow_service.observability.spans import Tracing
    from anchorflow_service.zenoh_endpoint import ZenohEndpoint

logger = logging.getLogger(__name__)

ZENOH_WAIT_S = 5.0
"""How long a router may take to be there when the service starts."""


@dataclass(frozen=True)
class ServeChoice:
    """What is served, and how; it can be sent to another process."""

    bundles: list[Path] | None
    repository: Path | None
    provider: Provider
    tokens: Path | None
    tls: TlsFiles
    connections: ConnectionLimits
    limits: ServiceLimits
    draining: Draining
    traces: str | None
    log_format: LogFormat
    log_level: LogLevel

    @property
    def token_file(self) -> TokenFile | None:
        """Opened anew. Raises `TokenFileError` where it cannot be used."""
        return None if self.tokens is None else TokenFile(self.tokens)

    @property
    def folders(self) -> BundleFolders:
        """Where the bundles lie. Raises `RepositoryError` where that is no folder."""
        return folders_of(self.bundles, self.repository)

    def for_one_of(self, workers: int) -> ServeChoice:
        """The same for a worker among so many; threads that are not named are shared out."""
        threads = self.limits.threads or max(1, usable_cores() // workers)
        return replace(self, limits=replace(self.limits, threads=threads))


@dataclass(frozen=True)
class Opened:
    """A service whose models are loaded; it answers once a server runs its application."""

    app: FastAPI
    service: PlanningService
    models: str
    """Names and versions."""
    zenoh: ZenohEndpoint | None


def open_service(
    choice: ServeChoice,
    tokens: TokenFile | None,
    *,
    zenoh: ZenohChoice | None = None,
    one_of_several: bool = False,
    models: tuple[str, ...] = (),
) -> Opened:
    """Load the bundles and put the application together.

    Args:
        choice: what is served.
        tokens: who may ask; None: everybody.
        zenoh: the network to join too; None: none.
        one_of_several: among processes that count together.
        models: names that have to be among those served, the default first; empty: any.

    Raises:
        AnchorFlowError: a bundle cannot be served, or there is no way to the zenoh network.
    """

    def open_engine(folder: Path) -> Engine:
        return Engine(load_bundle(folder), threads=choice.limits.threads, provider=choice.provider)

    folders = choice.folders
    engines = open_all(folders, open_engine)
    lacking = [name for name in models if name not in engines]
    if lacking:
        raise RepositoryError(f"expected {', '.join(lacking)}, which others serve, got no bundle")
    default = models[0] if models else next(iter(engines))
    service = PlanningService(engines, default=default, limits=choice.limits)
    endpoint = None if zenoh is None else zenoh_endpoint(service, zenoh)
    tracing = None if choice.traces is None else traced(service, choice.traces)
    repository = FixedRepository if one_of_several else Repository
    if one_of_several:
        reserve_shared_files()
    both: Sequence[AbstractAsyncContextManager[object] | None] = (tracing, endpoint)
    app = create_app(
        service,
        endpoints=[each for each in both if each is not None],
        tokens=tokens,
        repository=repository(service.engines, folders, open_engine),
        middleware=[] if tracing is None else [Middleware(tracing.middleware)],
    )
    # All of it stays as long as the process does: the collector need not look at it again.
    gc.collect()
    gc.freeze()
    return Opened(app, service, described(engines), endpoint)


def serving_line(models: str, choice: ServeChoice, listener: socket.socket) -> str:
    """What is told of a service once it answers."""
    url = url_of(listener, tls=choice.tls.certificate is not None)
    return f"{models} at {url} ({choice.folders})"


def tell(line: str) -> None:
    """Print it; a service whose output goes nowhere serves all the same."""
    try:
        typer.echo(line)
    except OSError as error:
        logger.warning("standard output cannot be written: %s", error.strerror)


def traced(service: PlanningService, url: str) -> Tracing:
    """Traces of the service, sent to the collector at the URL."""
    with needs_extra("otel", who="anchorflow serve --traces"):
        from anchorflow_service.observability.spans import tracing_to
    tracing = tracing_to(url)
    service.watch(tracing)
    return tracing


def zenoh_endpoint(service: PlanningService, choice: ZenohChoice) -> ZenohEndpoint:
    """The service on a zenoh network, joined here, so that what is wrong there is one line."""
    with needs_extra("zenoh", who="anchorflow serve --zenoh"):
        from anchorflow_client.zenoh_client.session import open_session
        from anchorflow_service.zenoh_endpoint import ZenohEndpoint
    session = open_session(choice.settings, wait_s=ZENOH_WAIT_S)
    return ZenohEndpoint(service, session, replica=choice.replica)
