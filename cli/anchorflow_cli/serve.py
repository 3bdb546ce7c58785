"""`anchorflow serve`: bundles over HTTP, and over zenoh where that is asked."""

from __future__ import annotations

import logging
import socket
import ssl
from contextlib import suppress
from dataclasses import replace
from typing import Annotated

import typer

from anchorflow_cli.listening import is_loopback, listen
from anchorflow_cli.model_options import (
    BatchOption,
    BatchWaitOption,
    BundlesOption,
    RepositoryOption,
    ThreadsOption,
    WaitingOption,
)
from anchorflow_cli.options import command_app
from anchorflow_cli.serve_open_files import within_open_files
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
    PerAddressOption,
    ProviderOption,
    TlsFiles,
    TokensOption,
    TracesOption,
    WorkersOption,
)
from anchorflow_cli.serve_workers import check_workers, serve_by_workers
from anchorflow_cli.serving import Opened, ServeChoice, open_service, serving_line, tell
from anchorflow_cli.zenoh_options import ZenohChoice, with_zenoh_options
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import AnchorServer, Draining
from anchorflow_service.observability.logs import set_up_logging
from anchorflow_service.planning import ServiceLimits

app = command_app()
logger = logging.getLogger(__name__)


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
    max_per_address: PerAddressOption = ConnectionLimits.max_per_address,
    max_body_bytes: BodyOption = ServiceLimits.max_body_bytes,
    max_waiting: WaitingOption = ServiceLimits.max_waiting,
    max_batch: BatchOption = ServiceLimits.max_batch,
    batch_wait_ms: BatchWaitOption = ServiceLimits.batch_wait_ms,
    threads: ThreadsOption = ServiceLimits.threads,
    workers: WorkersOption = 1,
    notice_s: NoticeOption = Draining.notice_s,
    drain_s: DrainOption = Draining.drain_s,
    log_format: LogFormatOption = "text",
    log_level: LogLevelOption = "warning",
    traces: TracesOption = None,
    zenoh: ZenohChoice | None,
) -> None:
    """Serve bundles over HTTP, and with --zenoh over zenoh too, until interrupted."""
    choice = ServeChoice(
        bundles=bundle,
        repository=repository,
        provider=provider,
        tokens=tokens,
        tls=TlsFiles(tls_cert, tls_key, tls_client_ca),
        connections=ConnectionLimits(max_connections, max_per_address),
        limits=ServiceLimits(max_body_bytes, max_waiting, max_batch, batch_wait_ms, threads),
        draining=Draining(notice_s=notice_s, drain_s=drain_s),
        traces=traces,
        log_format=log_format,
        log_level=log_level,
    )
    set_up_logging(log_format, log_level)
    choice = replace(choice, connections=within_open_files(choice.connections))
    if workers > 1:
        check_workers(zenoh)
        choice = choice.for_one_of(workers)
    tls, token_file = choice.tls.context(), choice.token_file
    with listen(host, port) as listener:
        if tokens is None and not is_loopback(listener):
            logger.warning("everybody who reaches this address may ask: there is no --tokens")
        if workers > 1:
            serve_by_workers(choice, listener, workers)
        else:
            opened = open_service(choice, token_file, zenoh=zenoh)
            _serve_alone(opened, choice, listener, tls=tls, zenoh=zenoh)


def _serve_alone(
    opened: Opened,
    choice: ServeChoice,
    listener: socket.socket,
    *,
    tls: ssl.SSLContext | None,
    zenoh: ZenohChoice | None,
) -> None:
    """In this process, until it is interrupted."""

    def say() -> None:
        tell(serving_line(opened.models, choice, listener))
        if zenoh is not None and opened.zenoh is not None:
            tell(f"zenoh replica {opened.zenoh.replica} ({zenoh.settings.describe()})")

    server = AnchorServer(
        opened.app,
        opened.service,
        limits=choice.connections,
        draining=choice.draining,
        tls=tls,
        say=say,
    )
    with suppress(KeyboardInterrupt):  # uvicorn has shut down when it raises the signal again
        server.run(sockets=[listener])
