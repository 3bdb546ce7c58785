"""The blocking and the async client over a transport with a prepared answer."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from staged_planner import ANSWER

from anchorflow_benchmarks.programs import free_port
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
PROXY_PAGE = b"<html>Bad gateway</html>"
both_kinds = pytest.mark.parametrize("kind", [AnchorClient, AsyncAnchorClient])


class Canned:
    """A transport that records requests and returns one answer."""

    def __init__(
        self, value: Any = ANSWER, status: int = 200, headers: Mapping[str, str] | None = None
    ) -> None:
        body = value if isinstance(value, bytes) else json.dumps(value).encode()
        self.answer: HttpAnswer = (status, headers or {}, body)
        self.sent: list[Any] = []
        self.closed = False

    def send(self, *sent: Any, **_: Any) -> HttpAnswer:
        self.sent.append(sent)
        return self.answer

    def close(self) -> None:
        self.closed = True


class Broken(Canned):
    """A transport without a connection."""

    def send(self, *_: Any, **__: Any) -> HttpAnswer:
        raise ConnectionFailed("nobody listens")


def refusal(code: str, status: int, **headers: str) -> Canned:
    return Canned({"error": {"code": code, "message": "full", "field": None}}, status, headers)


def encoded(codec: JsonCodec | OipCodec) -> Canned:
    """Return a transport that answers in the codec's form."""
    answer = codec.encode_answer(JsonCodec().decode_answer(Payload(json.dumps(ANSWER).encode())))
    headers = {"inference-header-content-length": str(answer.header_length)}
    return Canned(answer.body, headers=headers)


@pytest.fixture
def client(make_client: Callable[..., Any]) -> Client:
    """Makes either client, with the JSON codec by default."""

    def make(transport: Canned, **options: Any) -> Any:
        options = {"codec": JsonCodec()} | options
        return make_client("http://robot:8000/base/", transport=transport, **options)

    return make


def test_a_plan_is_one_post(client: Client, fields: dict[str, Any]) -> None:
    transport = Canned()

    with client(transport, token="secret", timeout_s=2.0) as it:
        anchors = it.plan(**fields, num_samples=1)
        assert not transport.closed

    assert transport.closed
    ((method, path, headers, body, timeout_s),) = transport.sent
    assert (method, path, timeout_s) == ("POST", "/base/anchors", 2.0)
    assert headers["Authorization"] == "Bearer secret"
    assert headers["Content-Type"] == "application/json"
    assert json.loads(body or b"")["num_samples"] == 1
    assert anchors.trajectories.shape == (1, 2, 2)
    assert (anchors.seed, anchors.request_id, anchors.model.name) == (3, "r1", "lines")


def test_binary_is_the_default_form(client: Client, fields: dict[str, Any]) -> None:
    transport = encoded(OipCodec())

    assert client(transport, codec=None).plan(**fields).seed == ANSWER["seed"]
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


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (
            {"cost_map": [[0, 1], [0]], "resolution": 0.1},
            r"a list of 2 like the first at cost_map\.data\[1\]",
        ),
        ({"cost_map": CostMap.build(np.zeros((1, 16, 20)), 0.5), "resolution": 0.1}, "cost_map"),
        ({"x_goal": [0, 0]}, "x_goal"),
    ],
)
def test_a_bad_field_is_refused_before_anything_is_sent(
    client: Client, fields: dict[str, Any], bad: dict[str, Any], words: str
) -> None:
    transport = Canned()
    with pytest.raises(InvalidRequest, match=words):
        client(transport).plan(**fields | bad)
    assert transport.sent == []


def test_a_refusal_is_raised_with_its_field(client: Client, fields: dict[str, Any]) -> None:
    with pytest.raises(Overloaded, match="full") as caught:
        client(refusal("overloaded", 429, **{"retry-after": "7"})).plan(**fields)
    assert caught.value.retry_after_s == 7


@pytest.mark.parametrize("codec", [JsonCodec(), OipCodec()])
def test_the_answer_to_another_request_is_refused(
    client: Client, fields: dict[str, Any], codec: Any
) -> None:
    asked = client(encoded(codec), codec=codec)
    assert asked.plan(**fields, request_id="r1").request_id == "r1"
    with pytest.raises(InvalidAnswer, match="expected the answer to r2, got that to r1"):
        asked.plan(**fields, request_id="r2")


@pytest.mark.parametrize("body", [PROXY_PAGE, b"Internal Server Error", b"[]", b"", TOO_DEEP])
@pytest.mark.parametrize("status", [404, 501, 500, 502, 503, 504])
def test_an_error_without_the_contracts_json(
    client: Client, fields: dict[str, Any], status: int, body: bytes
) -> None:
    """A proxy's error may be transient: the service behind it may be gone for a moment."""
    is_proxy = status not in (404, 501)
    error = ConnectionFailed if is_proxy else InvalidAnswer
    words = "not in the service's own words" if is_proxy else "without the contract's error JSON"
    with pytest.raises(error, match=f"status {status},? {words}"):
        client(Canned(body, status)).plan(**fields)


def test_cards_are_read(client: Client, card: ModelCard) -> None:
    transport = Canned({"models": [card.to_dict() | {"ready": True}]})

    assert client(transport).models() == (card,)
    assert transport.sent[0][:2] == ("GET", "/base/v2/models")
    with pytest.raises(InvalidAnswer, match="not a list of model cards"):
        client(Canned({"models": [card.to_dict() | {"inputs": [[]]}]})).models()


@pytest.mark.parametrize(
    ("value", "words"),
    [
        *((value, ".") for value in ({}, [], {"models": [{}]}, {"models": 3}, b"no", TOO_DEEP)),
        (b'{"models": [' + b"9" * 5000 + b"]}", "got an integer of too many digits"),
    ],
)
def test_an_invalid_list_of_cards_is_an_invalid_answer(
    client: Client, value: Any, words: str
) -> None:
    with pytest.raises(InvalidAnswer, match=words):
        client(Canned(value)).models()


def test_health_is_a_yes_or_a_no(client: Client) -> None:
    assert client(Canned({"ready": True})).ready()
    assert client(Canned({"live": True})).live()
    for no in (refusal("not_ready", 503), Canned(PROXY_PAGE, 502), Broken()):
        assert not client(no).ready()
        assert not client(no).live()
    with pytest.raises(InternalError):
        client(refusal("internal", 500)).ready()


STRANGE_URLS = [
    "robot:8000",
    "ftp://robot",
    "http://",
    "http://robot:port",
    "http://robot:0",
    "http://[::1",
    "http://robot..de",
    f"http://{'robot' * 13}.de",
]
URLS_WITH_A_PASSWORD = [
    "http://robot:secret@host",
    "https://robot:secret@host:8000/base",
    "http://secret@host:port",
    "http://robot:secret@[::1",
    "robot:secret@host",
]
TIMES = ("timeout_s", "connect_timeout_s")
NO_TIME = "expected a number above 0, got"
BAD_ARGUMENTS: list[tuple[str, dict[str, Any], str]] = [
    *((url, {}, "http://|[Pp]ort") for url in STRANGE_URLS),
    *((url, {}, "user before the host; .* token=") for url in URLS_WITH_A_PASSWORD),
    *(
        ("http://robot", {"token": f"secret{end}"}, "^token: expected printable ASCII")
        for end in ("\n", "\r\nX: y", "ä")
    ),
    *(
        ("http://robot", {name: math.inf}, rf"{name}: expected at most 1e\+06 s, got inf")
        for name in TIMES
    ),
    *(
        ("http://robot", {name: seconds}, re.escape(f"{name}: {NO_TIME} {seconds}"))
        for name in TIMES
        for seconds in (0, -1.0, math.nan, None)
    ),
]


@both_kinds
@pytest.mark.parametrize(("url", "options", "words"), BAD_ARGUMENTS)
def test_a_bad_argument_is_named_and_a_secret_is_not_repeated(
    kind: Callable[..., object], url: str, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        kind(url, **options)
    assert "secret" not in str(caught.value)


@both_kinds
@pytest.mark.parametrize(
    "url", ["http://robot/a@b", "http://robot.de.", "http://[::1]:8000", "http://räuber.de"]
)
def test_an_unusual_host_is_accepted(kind: Callable[[str], object], url: str) -> None:
    kind(url)


def test_a_time_may_be_a_number_of_numpy(client: Client, fields: dict[str, Any]) -> None:
    transport = Canned()
    client(transport, timeout_s=np.float32(1)).plan(**fields)
    assert type(transport.sent[0][-1]) is float

    times: dict[str, Any] = dict.fromkeys(TIMES, np.float32(1))
    assert not AnchorClient(f"http://127.0.0.1:{free_port()}", **times).live()
