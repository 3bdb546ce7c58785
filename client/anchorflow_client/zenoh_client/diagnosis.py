"""Find out why a connection failed: zenoh does not say, so connect once with plain TCP or TLS."""

from __future__ import annotations

import re
import socket
import ssl
from dataclasses import dataclass

from anchorflow_client.errors import ConnectionFailed, TransportError, Unauthorized

CONNECT_TIMEOUT_S = 1.0
NOBODY = "nobody listens at"
"""How the message begins if no endpoint could be reached."""
ALERT_S = 0.25
"""Time after the handshake in which a listener may reject this node's certificate."""


@dataclass(frozen=True)
class Approach:
    """How a node tried to connect."""

    endpoints: tuple[str, ...]
    """In zenoh's form: protocol/host:port."""
    root_ca: str | None = None
    certificate: str | None = None
    private_key: str | None = None
    verify_name: bool = True
    user: str | None = None


class _Untrusted(Exception):
    """The TLS handshake failed."""


def explain(approach: Approach) -> TransportError | Unauthorized:
    """Return the likeliest reason: no listener, a failed handshake, or a rejected node."""
    faults = [(endpoint, _fault(endpoint, approach)) for endpoint in approach.endpoints]
    if reachable := [endpoint for endpoint, fault in faults if fault is None]:
        if approach.user is None:
            hint = "it wants a user and a password (or is no zenoh node)"
        else:
            hint = f"the user {approach.user!r} or its password is wrong (or it is no zenoh node)"
        return Unauthorized(f"{', '.join(reachable)} does not let this node in: {hint}")
    if untrusted := [f"{end}: {why}" for end, why in faults if isinstance(why, _Untrusted)]:
        return ConnectionFailed("; ".join(untrusted))
    if faults:
        absent = "; ".join(f"{endpoint}: {fault}" for endpoint, fault in faults)
        return ConnectionFailed(f"{NOBODY} {absent}")
    return ConnectionFailed("no zenoh node was found, and none is named to connect to")


def _fault(endpoint: str, approach: Approach) -> Exception | None:
    """Return why an endpoint cannot be reached; None if it accepts connections."""
    try:
        _try_to_connect(endpoint, approach)
    except (OSError, ValueError, _Untrusted) as error:
        return error
    return None


def _try_to_connect(endpoint: str, approach: Approach) -> None:
    """Connect and disconnect. Raises `OSError`, `ValueError` for a bad host, or `_Untrusted`."""
    protocol, _, rest = endpoint.partition("/")
    host, _, port = re.split(r"[?#]", rest)[0].rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdecimal():
        raise OSError(f"could not be connected to over {protocol}")
    address = (host.strip("[]"), int(port))
    with socket.create_connection(address, timeout=CONNECT_TIMEOUT_S) as connection:
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
    except ssl.SSLError as error:  # TLSV13_ALERT_CERTIFICATE_REQUIRED becomes words
        reason = (error.reason or str(error)).replace("_", " ").lower()
        raise _Untrusted(f"TLS: {reason}") from error
    except TimeoutError:
        return  # the listener waits for the first message, so the handshake is complete
    except OSError as error:
        raise _Untrusted(f"TLS: the handshake breaks off: {error}") from error


def _speaks_tls(connection: socket.socket) -> bool:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    connection.settimeout(ALERT_S)
    try:
        with context.wrap_socket(connection):
            return True
    except OSError:  # a zenoh node disconnects, or waits for more bytes
        return False
