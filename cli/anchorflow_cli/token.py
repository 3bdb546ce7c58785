"""`anchorflow token`: make a bearer token and add its digest to the file of `serve --tokens`."""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_cli.options import command_app
from anchorflow_service.http.tokens import INFER, SCOPES, TokenFileError, read_tokens, token_line

app = command_app()


@app.command()
def token(
    file: Annotated[Path, typer.Argument(help="File of tokens; made if there is none.")],
    name: Annotated[str, typer.Argument(help="Whom it is for.")],
    *,
    scopes: Annotated[str, typer.Option(help=f"Comma-separated, of {', '.join(SCOPES)}.")] = INFER,
) -> None:
    """Print a new token and add its digest to a file. It is shown this once: nothing keeps it."""
    new = secrets.token_urlsafe(32)
    try:
        line = token_line(name, tuple(scopes.split(",")), new)
    except ValueError as error:
        raise TokenFileError(str(error)) from error
    if file.exists() and name in {each.name for each in read_tokens(file)}:
        raise TokenFileError(f"{file}: has a token named {name} already")
    append_line(file, line)
    typer.echo(new)


def append_line(file: Path, line: str) -> None:
    """Append a line to the file; a new file is readable by its owner only."""
    try:
        descriptor = os.open(file, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o600)
        with os.fdopen(descriptor, "r+b") as out:
            text = out.read()
            # An editor may have left the last line without a newline.
            begin = "\n" if text and not text.endswith(b"\n") else ""
            out.write(f"{begin}{line}\n".encode())
    except OSError as error:
        raise TokenFileError(f"{file}: cannot be written: {error.strerror}") from error
