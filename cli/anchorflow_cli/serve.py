"""`anchorflow serve`: bundles over HTTP, and over zenoh where that is asked."""

from __future__ import annotations

import ipaddress
import logging
import socket
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from starlette.middleware import Middleware

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.model_options import (
    BatchOption,
    BatchWaitOption,
    BundlesOption,
    RepositoryOption,
    ThreadsOption,
    WaitingOption,
    described,
    folders_of,
)
from anchorflow_cli.options import command_app
from anchorflow_cli.serve_options import (
    BodyOption,
    CertificateOption,
    ClientCaOption,
    ConnectionsOption,
    DrainOption,
    KeyOption,
    LogFormatOption,
    LogLevelOption,
    NoticeOption,
    ProviderOption,
    TokensOption,
    TracesOption,
    tls_choice,
)
from anchorflow_cli.zenoh_options import ZenohChoice, with_zenoh_options
from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import AnchorServer, Draining
from anchorflow_service.http.tokens import TokenFile
from anchorflow_service.observability.logs import set_up_logging
from anchorflow_service.planning import Limits, PlanningService
from anchorflow_service.providers import DEFAULT_PROVIDER
from anchorflow_service.repository import Repository, open_all

if TYPE_CHECKING:
    from anchorflow_service.observability.tracing import Tracing
    from anchorflow_service.zenoh_endpoint import ZenohEndpoint

app = command_app()
logger = logging.getLogger(__name__)

ZENOH_WAIT_S = 5.0
"""How long a router may take to be there when the service starts."""


class AddressError(AnchorFlowError):
    """The address cannot be listened on."""


@app.command()
@with_zenoh_options
def serve(
    *,
    bundle: BundlesOption = None,
    repository: RepositoryOption = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")] = 8000,
    provider: ProviderOption = DEFAULT_PROVIDER,
    tokens: TokensOption = None,
    tls_cert: CertificateOption = None,
    tls_key: KeyOption = None,
    tls_client_ca: ClientCaOption = None,
    max_connections: ConnectionsOption = ConnectionLimits.max_connections,
    max_body_bytes: BodyOption = Limits.max_body_bytes,
    max_waiting: WaitingOption = Limits.max_waiting,
    max_batch: BatchOption = Limits.max_batch,
    batch_wait_ms: BatchWaitOption = Limits.batch_wait_ms,
    threads: ThreadsOption = Limits.threads,
    notice_s: NoticeOption = Draining.notice_s,
    drain_s: DrainOption = Draining.drain_s,
    log_format: LogFormatOption = "text",
    log_level: LogLevelOption = "warning",
    traces: TracesOption = None,
    zenoh: ZenohChoice | None,
) -> None:
    """Serve bundles over HTTP, and with --zenoh over zenoh too, until interrupted."""

    def open_engine(folder: Path) -> Engine:
        return Engine(load_bundle(folder), threads=threads, provider=provider)

    set_up_logging(log_format, log_level)
    tls = tls_choice(tls_cert, tls_key, tls_client_ca)
    token_file = None if tokens is None else TokenFile(tokens)
    with listen(host, port) as listener:
        if tokens is None and not is_loopback(listener):
            logger.warning("everybody who reaches this address may ask: there is no --tokens")
        folders = folders_of(bundle, repository)
        engines = open_all(folders, open_engine)
        limits = Limits(max_body_bytes, max_waiting, max_batch, batch_wait_ms, threads)
        service = PlanningService(engines, default=next(iter(engines)), limits=limits)
        endpoint = None if zenoh is None else zenoh_endpoint(service, zenoh)
        tracing = None if traces is None else traced(service, traces)
        http = create_app(
            service,
            endpoints=[each for each in (tracing, endpoint) if each is not None],
            tokens=token_file,
            repository=Repository(service.engines, folders, open_engine),
            middleware=[] if tracing is None else [Middleware(tracing.middleware)],
        )
        server = AnchorServer(
            http,
            service,
            limits=ConnectionLimits(max_connections=max_connections),
            draining=Draining(notice_s=notice_s, drain_s=drain_s),
            tls=tls,
        )
        typer.echo(f"{described(engines)} at {url_of(listener, tls=bool(tls))} ({folders})")
        if zenoh is not None and endpoint is not None:
            typer.echo(f"zenoh replica {endpoint.replica} ({zenoh.settings.describe()})")
        with suppress(KeyboardInterrupt):  # uvicorn has shut down when it raises the signal again
            server.run(sockets=[listener])


def traced(service: PlanningService, url: str) -> Tracing:
    """Traces of the service, sent to the collector at the URL."""
    with needs_extra("otel", who="anchorflow serve --traces"):
        from anchorflow_service.observability.tracing import tracing_to
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


def listen(host: str, port: int) -> socket.socket:
    """A listening socket. Raises `AddressError` where the address is taken or not this machine's.

    Made here and not by uvicorn, so that the address that is printed answers, and a port in use
    is one line, before a bundle is loaded for nothing.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family)
        # Connections inherit it. asyncio sets it for listeners of its own alone, and without it the
        # second packet of every answer waits 40 ms for the client to acknowledge the first.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listener
    except OSError as error:
        reason = str(error.strerror).partition(" (while")[0]  # Python repeats the address there
        raise AddressError(f"cannot listen on {host}:{port}: {reason}") from error


def url_of(listener: socket.socket, *, tls: bool = False) -> str:
    host, port = listener.getsockname()[:2]
    scheme = "https" if tls else "http"
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def is_loopback(listener: socket.socket) -> bool:
    """Whether nobody but this machine reaches it."""
    return ipaddress.ip_address(listener.getsockname()[0]).is_loopback
