"""Why a connection did not come about. Zenoh says only that it did not; so knock once by hand."""

from __future__ import annotations

import re
import socket
import ssl
from dataclasses import dataclass

from anchorflow_client.errors import ConnectionFailed, TransportError, Unauthorized

KNOCK_S = 1.0
"""Longest wait for an endpoint to be reached."""
NOBODY = "nobody listens at"
"""How the words begin where nobody could be reached."""
ALERT_S = 0.25
"""How long after the handshake a listener may take to say that it wants another certificate."""


@dataclass(frozen=True)
class Approach:
    """How a node tried to connect."""

    endpoints: tuple[str, ...]
    """As zenoh writes them: protocol/host:port."""
    root_ca: str | None = None
    certificate: str | None = None
    private_key: str | None = None
    verify_name: bool = True
    user: str | None = None


class _Untrusted(Exception):
    """The TLS handshake fails."""


def explain(approach: Approach) -> TransportError | Unauthorized:
    """The likeliest reason: nobody is there, TLS fails, or the node is not let in."""
    faults = [(endpoint, _fault(endpoint, approach)) for endpoint in approach.endpoints]
    if open_to_all := [endpoint for endpoint, fault in faults if fault is None]:
        who = ", ".join(open_to_all)
        return Unauthorized(f"{who} does not let this node in: {_of_user(approach.user)}")
    if untrusted := [f"{end}: {why}" for end, why in faults if isinstance(why, _Untrusted)]:
        return ConnectionFailed("; ".join(untrusted))
    if faults:
        absent = "; ".join(f"{endpoint}: {fault}" for endpoint, fault in faults)
        return ConnectionFailed(f"{NOBODY} {absent}")
    return ConnectionFailed("no zenoh node was found, and none is named to connect to")


def _fault(endpoint: str, approach: Approach) -> Exception | None:
    """Why nothing can be said to an endpoint; None where it listens."""
    try:
        _knock(endpoint, approach)
    except (OSError, ValueError, _Untrusted) as error:
        return error
    return None


def _of_user(user: str | None) -> str:
    if user is None:
        return "it wants a user and a password (or is no zenoh node)"
    return f"the user {user!r} or its password is wrong (or it is no zenoh node)"


def _knock(endpoint: str, approach: Approach) -> None:
    """Connect and hang up.

    Raises:
        OSError: nobody is there.
        ValueError: the host cannot be a name.
        _Untrusted: TLS fails.
    """
    protocol, _, rest = endpoint.partition("/")
    host, _, port = re.split(r"[?#]", rest)[0].rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdecimal():
        raise OSError(f"could not be connected to over {protocol}")
    address = (host.strip("[]"), int(port))
    with socket.create_connection(address, timeout=KNOCK_S) as connection:
        if protocol == "tls":
            _shake_hands(connection, address[0], approach)
        elif _speaks_tls(connection):
            raise _Untrusted("it speaks TLS; expected an endpoint tls/…")


def _shake_hands(connection: socket.socket, host: str, approach: Approach) -> None:
    try:
        context = ssl.create_default_context(cafile=approach.root_ca)
        context.check_hostname = approach.verify_name
        if approach.certificate:
            context.load_cert_chain(approach.certificate, approach.private_key)
        with context.wrap_socket(connection, server_hostname=host) as secured:
            secured.settimeout(ALERT_S)
            secured.recv(1)
    except ssl.SSLCertVerificationError as error:
        raise _Untrusted(f"TLS: its certificate is refused: {error.verify_message}") from error
    except ssl.SSLError as error:
        raise _Untrusted(f"TLS: {_reason(error)}") from error
    except TimeoutError:
        return  # it waits for the first word, so the handshake is done
    except OSError as error:
        raise _Untrusted(f"TLS: the handshake breaks off: {error}") from error


def _reason(error: ssl.SSLError) -> str:
    """`TLSV13_ALERT_CERTIFICATE_REQUIRED` as words."""
    return (error.reason or str(error)).replace("_", " ").lower()


def _speaks_tls(connection: socket.socket) -> bool:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    connection.settimeout(ALERT_S)
    try:
        with context.wrap_socket(connection):
            return True
    except OSError:  # a zenoh node hangs up, or waits for the rest of what it took for a length
        return False
