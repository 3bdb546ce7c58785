"""The parser reads every answer that HTTP allows, however its bytes are cut."""

from __future__ import annotations

import http.client
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from anchorflow_client.http.answer_parser import MAX_HEAD_LINES, MAX_LINE, AnswerParser

CHUNKED = (
    b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
    b"3;why=not\r\nabc\r\nA\r\n0123456789\r\n0\r\nX-Trailer: t\r\n\r\n"
)
ANSWERS = {
    "length": (b"HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\nabc", b"abc", True),
    "chunks": (CHUNKED, b"abc0123456789", True),
    "empty": (b"HTTP/1.1 204 No Content\r\n\r\n", b"", True),
    "to the end": (b"HTTP/1.1 200 OK\r\n\r\nabc", b"abc", False),
    "not kept": (
        b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: 1\r\n\r\na",
        b"a",
        False,
    ),
    "version 1.0": (b"HTTP/1.0 200 OK\r\nContent-Length: 1\r\n\r\na", b"a", False),
    "bare newlines": (b"HTTP/1.1 200 OK\nContent-Length: 1\n\na", b"a", True),
    "after interim ones": (
        b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 103 Early Hints\r\nLink: a\r\n\r\n"
        b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\n\r\na",
        b"a",
        True,
    ),
}


@pytest.mark.parametrize(("data", "body", "kept"), ANSWERS.values(), ids=ANSWERS)
@given(cut=st.lists(st.integers(0, 200), max_size=5))
def test_an_answer_is_the_same_however_it_is_cut(
    data: bytes, body: bytes, kept: bool, cut: list[int]
) -> None:
    parser = AnswerParser()
    places = {place for place in cut if place < len(data)}
    for start, end in pairwise(sorted({0, *places, len(data)})):
        parser.feed(data[start:end])
    parser.end()

    assert parser.answer is not None
    assert parser.answer[0] in (200, 204)
    assert parser.answer[2] == body
    assert parser.keeps_alive is kept


@pytest.mark.parametrize("name", [name for name in ANSWERS if name != "to the end"])
def test_it_is_complete_with_its_last_byte_and_not_before(name: str) -> None:
    data, _, kept = ANSWERS[name]
    parser = AnswerParser()

    parser.feed(data[:-1])
    assert parser.answer is None
    parser.feed(data[-1:])
    assert parser.answer is not None
    assert parser.keeps_alive is kept


def test_names_are_in_lower_case_and_lines_are_joined() -> None:
    parser = AnswerParser()
    parser.feed(b"HTTP/1.1 200\r\nX-A: b\r\n\tc\r\nx-a: d\r\nContent-Length: 0\r\n\r\n")

    assert parser.answer == (200, {"x-a": "b c, d", "content-length": "0"}, b"")


@pytest.mark.parametrize("end", [1, 20, 45, len(CHUNKED) - 1])
def test_an_answer_that_breaks_off_is_incomplete(end: int) -> None:
    parser = AnswerParser()
    parser.feed(CHUNKED[:end])

    with pytest.raises(http.client.IncompleteRead):
        parser.end()


def test_no_answer_at_all_is_a_lost_connection() -> None:
    with pytest.raises(ConnectionError, match="without an answer"):
        AnswerParser().end()


@pytest.mark.parametrize("pieces", [[b"", b"more"], [b"more"]])
def test_a_connection_with_more_than_the_answer_is_not_kept(pieces: list[bytes]) -> None:
    parser = AnswerParser()
    parser.feed(ANSWERS["length"][0] + pieces[0])
    for piece in pieces[1:]:
        parser.feed(piece)

    assert parser.answer is not None
    assert not parser.keeps_alive


NOT_HTTP = {
    "ssh": b"SSH-2.0-OpenSSH_9.6\r\n",
    "no status": b"HTTP/1.1 abc\r\n\r\n",
    "version": b"HTTP/2.0 200 OK\r\n\r\n",
    "long line": b"x" * (MAX_LINE + 1),
    "long head": b"HTTP/1.1 200 OK\r\n" + b"A: b\r\n" * (MAX_HEAD_LINES + 1),
    "length": b"HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n",
    "two lengths": b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
    "no colon": b"HTTP/1.1 200 OK\r\nno colon\r\n\r\n",
    "no name": b"HTTP/1.1 200 OK\r\n: no name\r\n\r\n",
    "space": b"HTTP/1.1 200 OK\r\nContent-Length : 1\r\n\r\n",
    "minus": CHUNKED.replace(b"3;why", b"-3;why"),
    "underscore": CHUNKED.replace(b"3;why", b"0_3;why"),
    "letters": CHUNKED.replace(b"3;why", b"zz;why"),
}


@pytest.mark.parametrize("data", NOT_HTTP.values(), ids=NOT_HTTP)
def test_another_protocol_is_refused_at_once(data: bytes) -> None:
    with pytest.raises(http.client.HTTPException):
        AnswerParser().feed(data)
