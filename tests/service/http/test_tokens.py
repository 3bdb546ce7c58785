"""The token file: valid and invalid lines, and changes while the service runs."""

from __future__ import annotations

import errno
import hashlib
import logging
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from anchorflow_service.http.tokens import (
    RELOAD_S,
    TokenFile,
    TokenFileError,
    digest_of,
    read_tokens,
    token_line,
)

GOOD = token_line("robot-7", ("infer",), "first")
OTHER = token_line("fleet", ("infer", "admin"), "second")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "tokens"
    file.write_text(f"# the fleet's\n\n{GOOD}\n   {OTHER}\n")
    return file


@pytest.fixture
def tokens(path: Path, clock: Any) -> TokenFile:
    return TokenFile(path, clock=clock)


def test_a_line_holds_the_digest_and_not_the_token() -> None:
    digest = hashlib.sha256(b"first").hexdigest()

    assert f"robot-7 infer sha256:{digest}" == GOOD


def test_tokens_are_found_by_what_is_presented(tokens: TokenFile) -> None:
    found = tokens.find("second")

    assert found is not None
    assert (found.name, found.scopes) == ("fleet", {"infer", "admin"})
    assert found.digest == digest_of("second")
    for wrong in ("", "Second", "second ", "third", GOOD, found.digest.hex(), "é\u2603"):
        assert tokens.find(wrong) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no token"),
        ("# nobody\n", "holds no token"),
        ("secret-by-mistake", "line 1: expected NAME SCOPES sha256:DIGEST, got 1 words"),
        (f"{GOOD}\nname infer", "line 2: expected NAME SCOPES sha256:DIGEST, got 2 words"),
        (GOOD.replace("infer", "infer,root"), "line 1: expected scopes among infer,admin"),
        (GOOD.replace("infer", ","), "line 1: expected scopes among infer,admin"),
        (GOOD.replace("robot-7", "robot/7"), "line 1: expected a name"),
        (GOOD.replace("sha256:", ""), "line 1: expected sha256: and 64 hexadecimal digits"),
        (GOOD[:-1], "line 1: expected sha256: and 64 hexadecimal digits"),
        (GOOD[:-1] + "g", "line 1: expected sha256: and 64 hexadecimal digits"),
        (f"{GOOD}\n{GOOD}", "line 2: the name robot-7 stands above already"),
    ],
)
def test_a_wrong_file_is_one_line_that_repeats_no_secret(
    path: Path, text: str, message: str
) -> None:
    path.write_text(text)

    with pytest.raises(TokenFileError) as caught:
        TokenFile(path)

    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)
    assert "secret-by-mistake" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(TokenFileError, match=r"absent: cannot be read: No such file"):
        read_tokens(tmp_path / "absent")
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    with pytest.raises(TokenFileError, match="binary: expected UTF-8 text"):
        read_tokens(tmp_path / "binary")


def replaced(path: Path) -> None:
    path.with_name("new").write_text(OTHER)
    path.with_name("new").replace(path)


def mounted(path: Path) -> None:
    """As a secret is, whose link then leads elsewhere."""
    path.rename(path.with_name("old"))
    path.symlink_to(path.with_name("old"))
    path.with_name("target").write_text(OTHER)
    path.with_name("staging").symlink_to(path.with_name("target"))
    path.with_name("staging").replace(path)


def of_the_same_time_and_size(path: Path) -> None:
    before = path.stat()
    path.write_text(path.read_text().replace(GOOD, token_line("robot-7", ("infer",), "other")))
    while True:
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
        if path.stat().st_ctime_ns != before.st_ctime_ns:  # it ticks every few milliseconds
            return


@pytest.mark.parametrize("change", [replaced, mounted, of_the_same_time_and_size])
def test_a_change_is_seen_within_a_second(
    path: Path, tokens: TokenFile, clock: Any, change: Callable[[Path], None]
) -> None:
    change(path)

    assert tokens.find("first") is not None  # not yet looked at again
    clock.now = RELOAD_S
    assert tokens.find("first") is None
    assert tokens.find("second") is not None


@pytest.mark.timeout(60)
def test_a_pipe_is_read_once(clock: Any, tmp_path: Path) -> None:
    """Reading it again would block the service until the next write."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as executor:
        executor.submit(pipe.write_text, OTHER)
        tokens = TokenFile(pipe, clock=clock)
    os.utime(pipe, ns=(1, 1))

    clock.now = RELOAD_S
    assert tokens.find("second") is not None


@pytest.mark.parametrize("gone", [False, True])
def test_a_file_that_breaks_leaves_the_tokens_as_they_were(
    path: Path, tokens: TokenFile, clock: Any, caplog: pytest.LogCaptureFixture, gone: bool
) -> None:
    if gone:
        path.unlink()
    else:
        path.write_text("nonsense")

    with caplog.at_level(logging.ERROR):
        for clock.now in (RELOAD_S, 2 * RELOAD_S, 3 * RELOAD_S):
            assert tokens.find("first") is not None

    assert len(caplog.records) == 1  # said once, not at every look
    assert "the tokens stay as they were" in caplog.text

    path.write_text(OTHER)
    os.utime(path, ns=(1, 1))
    clock.now = 4 * RELOAD_S
    assert tokens.find("first") is None


@pytest.mark.parametrize("fault", [errno.EMFILE, errno.EACCES])
def test_a_token_that_is_taken_away_does_not_outlive_a_failed_read(
    path: Path,
    tokens: TokenFile,
    clock: Any,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    fault: int,
) -> None:
    """The service may have too many open files, or the file its owner not set yet."""
    path.write_text(OTHER)

    def fail(*_: object, **__: object) -> str:
        raise OSError(fault, os.strerror(fault))

    with monkeypatch.context() as patched:
        patched.setattr(Path, "read_text", fail)
        for clock.now in (RELOAD_S, 2 * RELOAD_S):
            assert tokens.find("first") is not None
    assert caplog.text.count(f"cannot be read: {os.strerror(fault)}") == 1

    clock.now = 3 * RELOAD_S
    assert tokens.find("first") is None


def test_who_takes_the_last_token_away_shuts_everybody_out(
    path: Path, tokens: TokenFile, clock: Any, caplog: pytest.LogCaptureFixture
) -> None:
    path.write_text("# nobody\n")

    for clock.now in (RELOAD_S, 2 * RELOAD_S):
        assert tokens.find("first") is None
    assert caplog.text.count(f"0 tokens read from {path}") == 1

    path.write_text(OTHER)
    clock.now = 3 * RELOAD_S
    assert tokens.find("second") is not None
