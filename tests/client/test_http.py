"""The blocking and the async client over a transport that answers from a list."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorClient,
    AsyncAnchorClient,
    ConnectionFailed,
    CostMap,
    InternalError,
    InvalidAnswer,
    InvalidRequest,
    JsonCodec,
    ModelCard,
    OipCodec,
    Overloaded,
    Payload,
)
from anchorflow_client.http.transport import HttpAnswer

Client = Callable[..., Any]

TOO_DEEP = b"[" * 100_000

ANSWER = {
    "trajectories": [[[0.0, 0.0], [1.0, 0.0]]],
    "velocities": [[[0.0, 0.0], [0.0, 0.0]]],
    "accelerations": [[[0.0, 0.0], [0.0, 0.0]]],
    "scores": [1.0],
    "clearance": [0.5],
    "safe": [True],
    "dt": 1.0,
    "seed": 3,
    "model": {"name": "lines", "version": "1", "sha256": "ab"},
    "timing_ms": {"total": 1.0},
    "request_id": "r1",
}


class Canned:
    """A transport that keeps what is sent and gives one answer."""

    def __init__(
        self, value: Any = ANSWER, status: int = 200, headers: Mapping[str, str] | None = None
    ) -> None:
        body = value if isinstance(value, bytes) else json.dumps(value).encode()
        self.answer: HttpAnswer = (status, headers or {}, body)
        self.sent: list[tuple[str, str, Mapping[str, str], bytes | None, float]] = []
        self.closed = False

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        self.sent.append((method, path, headers, body, timeout_s))
        return self.answer

    def close(self) -> None:
        self.closed = True


class Broken(Canned):
    """A transport that reaches nobody."""

    def send(self, *_: Any, **__: Any) -> HttpAnswer:
        raise ConnectionFailed("nobody listens")


@pytest.fixture
def client(make_client: Callable[..., Any]) -> Client:
    """Makes either client, of JSON unless told."""

    def make(transport: Canned, **options: Any) -> Any:
        options = {"codec": JsonCodec()} | options
        return make_client("http://robot:8000/base/", transport=transport, **options)

    return make


def test_a_plan_is_one_post(client: Client, fields: dict[str, Any]) -> None:
    transport = Canned()

    anchors = client(transport, token="secret", timeout_s=2.0).plan(**fields, num_samples=1)

    method, path, headers, body, timeout_s = transport.sent[0]
    assert (method, path, timeout_s) == ("POST", "/base/anchors", 2.0)
    assert headers["Authorization"] == "Bearer secret"
    assert headers["Content-Type"] == "application/json"
    assert json.loads(body or b"")["num_samples"] == 1
    assert anchors.trajectories.shape == (1, 2, 2)
    assert (anchors.seed, anchors.request_id, anchors.model.name) == (3, "r1", "lines")


def test_binary_is_the_form_unless_one_is_told(client: Client, fields: dict[str, Any]) -> None:
    answer = JsonCodec().decode_answer(Payload(json.dumps(ANSWER).encode()))
    binary = OipCodec().encode_answer(answer)
    length = str(binary.header_length)
    transport = Canned(binary.body, headers={"inference-header-content-length": length})

    anchors = client(transport, codec=None).plan(**fields)

    assert anchors.seed == ANSWER["seed"]
    ((_, _, headers, body, _),) = transport.sent
    assert headers["Content-Type"] == headers["Accept"] == "application/octet-stream"
    assert body is not None
    assert json.loads(body[: int(headers["Inference-Header-Content-Length"])])["inputs"]


@pytest.mark.parametrize("shape", [(16, 20), (1, 16, 20), (2, 1, 16, 20)])
def test_a_map_may_be_an_array(
    client: Client, fields: dict[str, Any], shape: tuple[int, ...]
) -> None:
    transport = Canned()
    fields["cost_map"] = np.zeros(shape, bool)

    client(transport).plan(**fields, resolution=0.5, origin=(-5, -4))

    sent = json.loads(transport.sent[0][3] or b"")["cost_map"]
    assert np.shape(sent["data"]) == ((1, 16, 20) if len(shape) == 2 else shape)
    assert (sent["resolution"], sent["origin"]) == (0.5, [-5.0, -4.0])


def test_a_ragged_map_is_refused_with_its_place(client: Client, fields: dict[str, Any]) -> None:
    fields["cost_map"] = [[0, 1], [0]]

    with pytest.raises(InvalidRequest, match=r"a list of 2 like the first at cost_map\.data\[1\]"):
        client(Canned()).plan(**fields, resolution=0.1)


def test_a_map_that_knows_its_place_takes_no_other(client: Client, fields: dict[str, Any]) -> None:
    fields["cost_map"] = CostMap.build(np.zeros((1, 16, 20)), 0.5)

    with pytest.raises(InvalidRequest, match="cost_map"):
        client(Canned()).plan(**fields, resolution=0.1)


def test_a_bad_field_is_refused_before_anything_is_sent(
    client: Client, fields: dict[str, Any]
) -> None:
    transport = Canned()

    fields["x_goal"] = [0, 0]
    with pytest.raises(InvalidRequest, match="x_goal"):
        client(transport).plan(**fields)
    assert transport.sent == []


def test_a_refusal_is_raised_with_its_field(client: Client, fields: dict[str, Any]) -> None:
    refusal = {"error": {"code": "overloaded", "message": "full", "field": None}}

    with pytest.raises(Overloaded, match="full") as caught:
        client(Canned(refusal, 429, {"retry-after": "7"})).plan(**fields)
    assert caught.value.retry_after_s == 7


def test_the_answer_to_another_request_is_refused(client: Client, fields: dict[str, Any]) -> None:
    assert client(Canned()).plan(**fields, request_id="r1").request_id == "r1"
    for codec in (JsonCodec(), OipCodec()):
        answer = codec.encode_answer(
            JsonCodec().decode_answer(Payload(json.dumps(ANSWER).encode()))
        )
        length = {"inference-header-content-length": str(answer.header_length)}
        transport = Canned(answer.body, headers=length)
        with pytest.raises(InvalidAnswer, match="expected the answer to r2, got that to r1"):
            client(transport, codec=codec).plan(**fields, request_id="r2")


@pytest.mark.parametrize("body", [b"<html>Not found</html>", b"[]", b"", TOO_DEEP])
@pytest.mark.parametrize("status", [404, 501])
def test_an_error_of_another_program_is_an_invalid_answer(
    client: Client, fields: dict[str, Any], status: int, body: bytes
) -> None:
    with pytest.raises(InvalidAnswer, match=f"status {status} without the contract's error JSON"):
        client(Canned(body, status)).plan(**fields)


@pytest.mark.parametrize(
    "body", [b"<html>Bad gateway</html>", b"Internal Server Error", b"[]", b"", TOO_DEEP]
)
@pytest.mark.parametrize("status", [500, 502, 503, 504])
def test_what_a_proxy_says_is_a_failed_connection(
    client: Client, fields: dict[str, Any], status: int, body: bytes
) -> None:
    """Behind it the service may be gone for a moment: the request may be sent again."""
    with pytest.raises(ConnectionFailed, match=f"status {status}, not in the service's own words"):
        client(Canned(body, status)).plan(**fields)


def test_a_service_behind_a_proxy_that_does_not_reach_it_is_not_ready(client: Client) -> None:
    assert not client(Canned(b"<html>Bad gateway</html>", 502)).ready()
    assert not client(Canned(b"<html>Bad gateway</html>", 502)).live()


def test_cards_are_read(client: Client, card: ModelCard) -> None:
    transport = Canned({"models": [card.to_dict() | {"ready": True}]})

    assert client(transport).models() == (card,)
    assert transport.sent[0][:2] == ("GET", "/base/v2/models")


@pytest.mark.parametrize("value", [{}, [], {"models": [{}]}, {"models": 3}, b"no", TOO_DEEP])
def test_what_is_no_list_of_cards_is_an_invalid_answer(client: Client, value: Any) -> None:
    with pytest.raises(InvalidAnswer):
        client(Canned(value)).models()


def test_cards_of_too_many_digits_are_refused_in_plain_words(client: Client) -> None:
    with pytest.raises(InvalidAnswer, match="got an integer of too many digits"):
        client(Canned(b'{"models": [' + b"9" * 5000 + b"]}")).models()


def test_a_card_of_another_make_is_an_invalid_answer(client: Client, card: ModelCard) -> None:
    with pytest.raises(InvalidAnswer, match="not a list of model cards"):
        client(Canned({"models": [card.to_dict() | {"inputs": [[]]}]})).models()


def test_health_is_a_yes_or_a_no(client: Client) -> None:
    not_ready = Canned({"error": {"code": "not_ready", "message": "", "field": None}}, 503)

    assert client(Canned({"ready": True})).ready()
    assert client(Canned({"live": True})).live()
    assert not client(not_ready).ready()
    assert not client(Broken()).live()


def test_health_does_not_swallow_other_errors(client: Client) -> None:
    failed = Canned({"error": {"code": "internal", "message": "", "field": None}}, 500)

    with pytest.raises(InternalError):
        client(failed).ready()


def test_leaving_the_block_closes_the_transport(client: Client) -> None:
    transport = Canned()

    with client(transport):
        assert not transport.closed
    assert transport.closed


STRANGE_URLS = [
    "robot:8000",
    "ftp://robot",
    "http://",
    "http://robot:port",
    "http://robot:0",
    "http://robot..de",
    f"http://{'robot' * 13}.de",
]


@pytest.mark.parametrize("url", STRANGE_URLS)
@pytest.mark.parametrize("kind", [AnchorClient, AsyncAnchorClient])
def test_a_strange_url_is_refused(kind: Callable[[str], object], url: str) -> None:
    with pytest.raises(ValueError, match=r"http://|[Pp]ort"):
        kind(url)


@pytest.mark.parametrize(
    "url",
    [
        "http://robot:secret@host",
        "https://robot:secret@host:8000/base",
        "http://secret@host:port",
        "http://robot:secret@[::1",
        "robot:secret@host",
    ],
)
@pytest.mark.parametrize("kind", [AnchorClient, AsyncAnchorClient])
def test_a_password_in_a_url_is_refused_and_not_repeated(
    kind: Callable[[str], object], url: str
) -> None:
    with pytest.raises(ValueError, match=r"user before the host; .* token=") as caught:
        kind(url)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    "url", ["http://robot/a@b", "http://robot.de.", "http://[::1]:8000", "http://räuber.de"]
)
@pytest.mark.parametrize("kind", [AnchorClient, AsyncAnchorClient])
def test_an_unusual_host_is_taken(kind: Callable[[str], object], url: str) -> None:
    kind(url)


@pytest.mark.parametrize("kind", [AnchorClient, AsyncAnchorClient])
@pytest.mark.parametrize("name", ["timeout_s", "connect_timeout_s"])
def test_a_wait_that_never_ends_is_refused(kind: Callable[..., object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name}: expected at most 1e\+06 s, got inf"):
        kind("http://robot", **{name: math.inf})


def test_a_time_may_be_a_number_of_numpy(client: Client, fields: dict[str, Any]) -> None:
    transport = Canned()
    client(transport, timeout_s=np.float32(1)).plan(**fields)
    assert type(transport.sent[0][-1]) is float

    times: dict[str, Any] = {"timeout_s": np.float32(1), "connect_timeout_s": np.float32(1)}
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
    assert not AnchorClient(url, **times).live()


@pytest.mark.parametrize("kind", [AnchorClient, AsyncAnchorClient])
@pytest.mark.parametrize("name", ["timeout_s", "connect_timeout_s"])
@pytest.mark.parametrize("seconds", [0, -1.0, float("nan"), None])
def test_a_time_that_is_none_is_refused(
    kind: Callable[..., object], name: str, seconds: float | None
) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected a number above 0, got {seconds}"):
        kind("http://robot", **{name: seconds})


@pytest.mark.parametrize("kind", [AnchorClient, AsyncAnchorClient])
@pytest.mark.parametrize("end", ["\n", "\r\nX: y", "ä"])
def test_a_token_that_no_header_carries_is_refused_and_not_repeated(
    kind: Callable[..., object], end: str
) -> None:
    with pytest.raises(ValueError, match=r"^token: expected printable ASCII") as caught:
        kind("http://robot", token=f"secret{end}")
    assert "secret" not in str(caught.value)
