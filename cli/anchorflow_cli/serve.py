"""`anchorflow serve`: bundles over HTTP, and over zenoh if asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.listening import within_open_files
from anchorflow_cli.options import command_app, url_option
from anchorflow_cli.serving import LogFormat, LogLevel, Provider, ServeChoice, serve_until_stopped
from anchorflow_cli.zenoh_options import ZenohChoice, with_zenoh_options
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import Draining, TlsFiles
from anchorflow_service.observability.logs import set_up_logging
from anchorflow_service.planning import ServiceLimits

app = command_app()


def option(help_text: str, *names: str, least: float | None = None, shown: bool = True) -> Any:
    """Return an option with a help text, a smallest value, and its default in the help or not."""
    return typer.Option(*names, help=help_text, min=least, show_default=shown)


BundlesOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--bundle",
        help="Folder of a bundle; repeatable, the first is the default model.",
        show_default="the one that ships",
    ),
]
RepositoryOption = Annotated[
    Path | None,
    option(
        "Folder of bundles, FOLDER/NAME or FOLDER/NAME/VERSION, to load and unload from.",
        shown=False,
    ),
]
BatchOption = Annotated[int, option("Requests of a micro-batch; 1: one after the other.", least=1)]
BatchWaitOption = Annotated[
    float, option("How long [ms] a micro-batch waits for others to join it.", least=0)
]
WaitingOption = Annotated[int, option("Requests that may wait; more are refused.", least=0)]
ThreadsOption = Annotated[
    int | None,
    typer.Option(min=1, help="Threads that requests share.", show_default="the cores"),
]
HostOption = Annotated[str, option("Address to listen on.")]
PortOption = Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")]
ProviderOption = Annotated[Provider, option("Where onnxruntime runs the graphs.")]
TokensOption = Annotated[
    Path | None, option("File of bearer tokens; `anchorflow token` makes one.", shown=False)
]
CertificateOption = Annotated[
    Path | None, option("PEM file: serve over TLS.", "--tls-cert", shown=False)
]
KeyOption = Annotated[Path | None, option("PEM file of its key.", "--tls-key", shown=False)]
ClientCaOption = Annotated[
    Path | None,
    option(
        "PEM file: callers must show a certificate of this authority.",
        "--tls-client-ca",
        shown=False,
    ),
]
ConnectionsOption = Annotated[
    int, option("Connections at a time; beyond, one that is idle is closed for each.", least=1)
]
PerAddressOption = Annotated[
    int | None,
    option(
        "Connections of one address at a time; three quarters of --max-connections unless given.",
        least=1,
        shown=False,
    ),
]
BodyOption = Annotated[int, option("Longest body of a request [bytes].", least=1)]
WorkersOption = Annotated[
    int, option("Processes that answer on the port, each with its own models.", least=1)
]
NoticeOption = Annotated[
    float, option("Time [s] from readiness turning false to the closing of the port.", least=0)
]
DrainOption = Annotated[float, option("Longest wait [s] for running requests on SIGTERM.", least=0)]
LogFormatOption = Annotated[LogFormat, option("Form of the log on stderr.")]
LogLevelOption = Annotated[LogLevel, option("From `info` on every request is a line.")]
TracesOption = Annotated[
    str | None,
    url_option(
        "OTLP collector to send traces to: http://127.0.0.1:4318/v1/traces.", show_default=False
    ),
]


@app.command()
@with_zenoh_options
def serve(
    *,
    bundle: BundlesOption = None,
    repository: RepositoryOption = None,
    host: HostOption = "127.0.0.1",
    port: PortOption = 8000,
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
    set_up_logging(log_format, log_level)
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
        workers=workers,
    )
    choice = replace(choice, connections=within_open_files(choice.connections))
    serve_until_stopped(choice, host, port, zenoh=zenoh)
