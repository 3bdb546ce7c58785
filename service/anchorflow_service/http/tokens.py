"""Bearer tokens: who may ask for what, from a file that is read again when it changes.

A line for each token; empty lines and lines that begin with # are passed over:

    NAME  SCOPES  sha256:DIGEST
    robot-7  infer        sha256:6f1ed002ab5595859014ebf0951522d9…
    fleet    infer,admin  sha256:2c26b46b68ffc68ff99b453c1d304134…

The file holds no token, only SHA-256 digests in hex. A token is random and long, so a slow hash
would protect it no better and cost every request milliseconds.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import re
import stat
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from anchorflow_client.errors import AnchorFlowError

INFER, ADMIN = "infer", "admin"
SCOPES = (INFER, ADMIN)
PREFIX = "sha256:"
NAME = re.compile(r"[\w.@-]{1,64}")
HEX_DIGITS = 64
RELOAD_S = 1.0
"""Between two looks at the file: a token that is taken away works no longer than this."""

logger = logging.getLogger(__name__)


class TokenFileError(AnchorFlowError):
    """The file of tokens cannot be read, or a line of it is not one of a token."""


@dataclass(frozen=True)
class Token:
    """What the file says of one token."""

    name: str
    """Of whom it was given to: for the log."""
    scopes: frozenset[str]
    digest: bytes
    """SHA-256, 32 bytes."""


class TokenFile:
    """The tokens of a file, as it is now.

    A file that breaks while the service runs, or cannot be read then, leaves the tokens that were
    valid before until it can be, and the log says why. One that holds no token any more lets nobody
    in.

    Raises:
        TokenFileError: it cannot be read, holds no token, or a line is wrong.
    """

    def __init__(self, path: Path, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = path
        self._clock = clock
        self._looked = clock()
        self._stamp = _stamp(path)
        self._tokens = _served(path)
        self._fault = ""
        """What the last look found wrong, so that the log says it once."""

    def find(self, presented: str) -> Token | None:
        """The token that was presented, where it is one of the file's."""
        self._reload()
        digest = digest_of(presented)
        # All are compared, each in constant time: how long it takes tells nothing.
        matches = [each for each in self._tokens if hmac.compare_digest(each.digest, digest)]
        return matches[0] if matches else None

    def _reload(self) -> None:
        now = self._clock()
        if now - self._looked < RELOAD_S:
            return
        self._looked = now
        stamp = _stamp(self._path)
        if stamp == self._stamp:
            return
        try:
            self._tokens = read_tokens(self._path)
        except TokenFileError as error:
            if str(error) != self._fault:
                logger.error("the tokens stay as they were: %s", error)
            self._fault = str(error)
            return
        self._stamp, self._fault = stamp, ""
        level = logging.INFO if self._tokens else logging.ERROR
        logger.log(level, "%d tokens read from %s", len(self._tokens), self._path)


def read_tokens(path: Path) -> tuple[Token, ...]:
    """The tokens of a file, which may hold none. Raises `TokenFileError`."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise TokenFileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise TokenFileError(f"{path}: expected UTF-8 text") from error
    try:
        return tuple(_parse(text))
    except ValueError as error:
        raise TokenFileError(f"{path}: {error}") from error


def token_line(name: str, scopes: tuple[str, ...], token: str) -> str:
    """The line of a token, as `read_tokens` reads it. Raises `ValueError` for what it would not."""
    line = f"{name} {','.join(scopes)} {PREFIX}{digest_of(token).hex()}"
    _token(line)
    return line


def digest_of(token: str) -> bytes:
    """SHA-256, 32 bytes."""
    return hashlib.sha256(token.encode()).digest()


def _served(path: Path) -> tuple[Token, ...]:
    """Raises `TokenFileError`, where there is none too."""
    tokens = read_tokens(path)
    if not tokens:
        raise TokenFileError(f"{path}: holds no token, so that nobody could ask anything")
    return tokens


def _parse(text: str) -> Iterator[Token]:
    names: set[str] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            token = _token(line)
            if token.name in names:
                raise ValueError(f"the name {token.name} stands above already")
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
        names.add(token.name)
        yield token


def _token(line: str) -> Token:
    # What came is not repeated: it may be a token that somebody put there by mistake.
    words = line.split()
    if len(words) != 3:
        raise ValueError(f"expected NAME SCOPES {PREFIX}DIGEST, got {len(words)} words")
    name, scopes, digest = words
    if not NAME.fullmatch(name):
        raise ValueError("expected a name of up to 64 letters, digits and . _ @ -")
    unknown = set(scopes.split(",")) - set(SCOPES)
    if unknown:
        raise ValueError(f"expected scopes among {','.join(SCOPES)}")
    hexadecimal = digest.removeprefix(PREFIX)
    if digest == hexadecimal or not re.fullmatch(rf"[0-9a-fA-F]{{{HEX_DIGITS}}}", hexadecimal):
        raise ValueError(f"expected {PREFIX} and {HEX_DIGITS} hexadecimal digits")
    return Token(name, frozenset(scopes.split(",")), bytes.fromhex(hexadecimal))


def _stamp(path: Path) -> tuple[int, ...] | None:
    """What changes when the file does; None where there is none, or a pipe, which is read once."""
    try:
        status = path.stat()
    except OSError:
        return None
    if not stat.S_ISREG(status.st_mode):
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino
