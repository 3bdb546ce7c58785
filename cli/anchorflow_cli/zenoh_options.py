"""`--zenoh…`: the options that join a command's service to a zenoh network as well."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from anchorflow_cli.extras import needs_extra
from anchorflow_client.errors import AnchorFlowError

if TYPE_CHECKING:
    from anchorflow_client.zenoh_client import ZenohSettings

MODE, CONFIG = "--zenoh", "--zenoh-config"
MANY = list[str] | None
PREFIX = "zenoh_"

# The settings of ZenohSettings, in its order, and the replica's name.
OPTIONS: dict[str, tuple[Any, str, str]] = {
    "config_file": (Path | None, CONFIG, "Zenoh's own JSON5 file; the options stand above it."),
    "mode": (str | None, MODE, "Join a zenoh network too, as peer, client or router."),
    "connect": (MANY, "--zenoh-connect", "Endpoint to connect to, tcp/HOST:PORT; repeatable."),
    "listen": (MANY, "--zenoh-listen", "Endpoint to listen on; by default tcp/127.0.0.1:7447."),
    "multicast": (bool | None, "--zenoh-multicast", "Look for others on the local network."),
    "tls_ca": (Path | None, "--zenoh-tls-ca", "PEM file of whom to trust."),
    "tls_certificate": (Path | None, "--zenoh-tls-certificate", "PEM file of this node."),
    "tls_private_key": (Path | None, "--zenoh-tls-private-key", "Its key."),
    "mutual_tls": (bool, "--zenoh-mutual-tls", "Who connects must show a certificate."),
    "user": (str | None, "--zenoh-user", "Name to be let in under."),
    "password": (Path | None, "--zenoh-password-file", "File whose first line is the password."),
    "users_file": (Path | None, "--zenoh-users-file", "Lines user:password of whom to let in."),
    "access_control_file": (
        Path | None,
        "--zenoh-access-control",
        "Zenoh file of which the access_control part is taken.",
    ),
    "replica": (str | None, "--zenoh-replica", "Name of this replica; drawn by default."),
}
METAVARS = {"mode": "peer|client|router", "connect": "ENDPOINT", "listen": "ENDPOINT"}


class ZenohOptionError(AnchorFlowError):
    """The options do not go together."""


@dataclass(frozen=True)
class ZenohChoice:
    """The network to join, and this replica's name there."""

    settings: ZenohSettings
    replica: str | None


def with_zenoh_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options to a command, which takes `zenoh: ZenohChoice | None`."""

    def run(**values: Any) -> None:
        given = {name: values.pop(PREFIX + name) for name in OPTIONS}
        command(**values, zenoh=_choice(given))

    signature = inspect.signature(command, eval_str=True)
    own = [each for each in signature.parameters.values() if each.name != "zenoh"]
    added = [_parameter(name) for name in OPTIONS]
    run.__signature__ = inspect.Signature([*own, *added])  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in [*own, *added]}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run


def _parameter(name: str) -> inspect.Parameter:
    kind, option, about = OPTIONS[name]
    info = typer.Option(option, help=about, metavar=METAVARS.get(name), show_default=False)
    default = False if kind is bool else None
    return inspect.Parameter(
        PREFIX + name,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[kind, info],
    )


def _choice(given: dict[str, Any]) -> ZenohChoice | None:
    """Return the chosen network, or None. Raises `ZenohOptionError`, `ZenohConfigError`."""
    named = {name: value for name, value in given.items() if value not in (None, [], False)}
    if not named:
        return None
    for name, value in named.items():
        if value == "":
            wanted = METAVARS.get(name, "a name")
            raise ZenohOptionError(f"{OPTIONS[name][1]}: expected {wanted}, got ''")
    if not named.keys() & {"mode", "config_file"}:
        stranger = OPTIONS[next(iter(named))][1]
        raise ZenohOptionError(f"{stranger}: expected {MODE} or {CONFIG} beside it")
    with needs_extra("zenoh", who=f"anchorflow serve {MODE}"):
        from anchorflow_client.zenoh_client import ZenohSettings
    replica = named.pop("replica", None)
    for name in ("connect", "listen"):
        named[name] = tuple(named.get(name, ()))
    if "password" in named:
        named["password"] = _first_line(named["password"])
    return ZenohChoice(ZenohSettings(**named), replica)


def _first_line(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").partition("\n")[0]
    except OSError as error:
        raise ZenohOptionError(f"--zenoh-password-file: {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ZenohOptionError(f"--zenoh-password-file: {path}: expected text, {error}") from error
