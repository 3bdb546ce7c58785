"""An answer's head leaves with what follows it, and at the latest before the connection closes."""

from __future__ import annotations

from unittest.mock import Mock, call

from anchorflow_service.http.joined_head import JoinedHead


def test_a_head_leaves_with_what_follows_it() -> None:
    transport = Mock()
    joined = JoinedHead(transport)

    joined.write(b"HTTP/1.1 100 Continue\r\n\r\n")
    joined.write(b"HTTP/1.1 200 OK\r\n\r\n")
    for part in (b"bo", b"dy"):
        joined.write(part)
    joined.flush()

    assert [call.args[0] for call in transport.write.call_args_list] == [
        b"HTTP/1.1 100 Continue\r\n\r\n",
        b"HTTP/1.1 200 OK\r\n\r\nbo",
        b"dy",
    ]


def test_a_head_without_a_body_leaves_before_the_connection_closes() -> None:
    transport = Mock()
    joined = JoinedHead(transport)

    joined.write(b"HTTP/1.1 204 No Content\r\n\r\n")
    transport.write.assert_not_called()
    joined.close()

    assert transport.mock_calls == [call.write(b"HTTP/1.1 204 No Content\r\n\r\n"), call.close()]
