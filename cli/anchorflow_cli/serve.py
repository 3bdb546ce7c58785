"""`anchorflow serve`: a bundle over HTTP."""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Annotated

import typer
import uvicorn

from anchorflow_cli.options import BundleOption, command_app
from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app

app = command_app()


class AddressError(AnchorFlowError):
    """The address cannot be listened on."""


@app.command()
def serve(
    *,
    bundle: BundleOption = DEFAULT_BUNDLE,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")] = 8000,
) -> None:
    """Serve a bundle over HTTP until interrupted."""
    with listen(host, port) as listener:
        engine = Engine(load_bundle(bundle))
        name, version = engine.card.name, engine.card.version
        http = create_app({name: engine}, default=name)
        server = uvicorn.Server(uvicorn.Config(http, log_level="warning"))
        typer.echo(f"{name} {version} at {url_of(listener)} (bundle {bundle})")
        with suppress(KeyboardInterrupt):  # uvicorn has shut down when it raises the signal again
            server.run(sockets=[listener])


def listen(host: str, port: int) -> socket.socket:
    """A listening socket. Raises `AddressError` where the address is taken or not this machine's.

    Made here and not by uvicorn, so that the address that is printed answers, and a port in use
    is one line, before a bundle is loaded for nothing.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        reason = str(error.strerror).partition(" (while")[0]  # Python repeats the address there
        raise AddressError(f"cannot listen on {host}:{port}: {reason}") from error


def url_of(listener: socket.socket) -> str:
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
