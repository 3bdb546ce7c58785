"""`anchorflow serve`: the options of its security, its life and what it tells of itself."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from anchorflow_cli.options import url_option
from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.http.tls import tls_context

# Literals, because typer reads its choices from the annotation.
LogFormat = Literal["text", "json"]
LogLevel = Literal["debug", "info", "warning", "error"]
Provider = Literal["cpu", "cuda", "tensorrt", "openvino"]

ProviderOption = Annotated[Provider, typer.Option(help="Where onnxruntime runs the graphs.")]
TokensOption = Annotated[
    Path | None,
    typer.Option(help="File of bearer tokens; `anchorflow token` makes one.", show_default=False),
]
CertificateOption = Annotated[
    Path | None, typer.Option("--tls-cert", help="PEM file: serve over TLS.", show_default=False)
]
KeyOption = Annotated[
    Path | None, typer.Option("--tls-key", help="PEM file of its key.", show_default=False)
]
ClientCaOption = Annotated[
    Path | None,
    typer.Option(
        "--tls-client-ca",
        help="PEM file: callers must show a certificate of this authority.",
        show_default=False,
    ),
]
ConnectionsOption = Annotated[
    int,
    typer.Option(min=1, help="Connections at a time; beyond, one that is idle is closed for each."),
]
PerAddressOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Connections of one address at a time; three quarters of --max-connections unless "
        "given.",
        show_default=False,
    ),
]
BodyOption = Annotated[int, typer.Option(min=1, help="Longest body of a request [bytes].")]
NoticeOption = Annotated[
    float,
    typer.Option(
        min=0,
        help="Time [s] from readiness turning false to the closing of the port.",
    ),
]
DrainOption = Annotated[
    float,
    typer.Option(min=0, help="Longest wait [s] for running requests on SIGTERM."),
]
LogFormatOption = Annotated[LogFormat, typer.Option(help="Form of the log on stderr.")]
LogLevelOption = Annotated[LogLevel, typer.Option(help="From `info` on every request is a line.")]
TracesOption = Annotated[
    str | None,
    url_option(
        "OTLP collector to send traces to: http://127.0.0.1:4318/v1/traces.", show_default=False
    ),
]
WorkersOption = Annotated[
    int, typer.Option(min=1, help="Processes that answer on the port, each with its own models.")
]


class ServeOptionError(AnchorFlowError):
    """The options do not go together."""


@dataclass(frozen=True)
class TlsFiles:
    """PEM files, as far as they are named."""

    certificate: Path | None
    key: Path | None
    client_ca: Path | None

    def context(self) -> ssl.SSLContext | None:
        """What they ask for. Raises `ServeOptionError`, `TlsError`."""
        if self.certificate and self.key:
            return tls_context(self.certificate, self.key, client_ca=self.client_ca)
        if self.certificate or self.key or self.client_ca:
            raise ServeOptionError("TLS needs --tls-cert and --tls-key, both of them")
        return None
