"""Models that are loaded and unloaded while a replica and a client are connected."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import pytest
from anyio.from_thread import start_blocking_portal

from anchorflow_client import AnchorBatch, UnknownModel
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

PATIENCE_S = 20


def named(engine: Any, name: str, version: str = "1.2.3") -> Any:
    """Return another engine of the same kind."""
    return type(engine)(replace(engine.card, name=name, version=version))


def test_a_model_is_answered_as_soon_as_it_is_loaded_or_swapped(
    client: ZenohAnchorClient, planning: PlanningService, engine: Any, fields: dict[str, Any]
) -> None:
    with pytest.raises(UnknownModel):
        client.plan(**fields, model="arcs")
    planning.engines.put(named(engine, "arcs"))
    assert client.plan(**fields, model="arcs").model.version == "1.2.3"
    assert "arcs" in [card.name for card in client.models()]

    planning.engines.put(named(engine, "arcs", "2.0"))
    assert client.plan(**fields, model="arcs").model.version == "2.0"


def test_an_unloaded_model_is_unknown_and_not_denied_and_may_come_back(
    client: ZenohAnchorClient, planning: PlanningService, engine: Any, fields: dict[str, Any]
) -> None:
    assert client.plan(**fields, model="bows").model.name == "bows"
    planning.engines.remove("bows")
    for _ in range(2):  # by the old info, and by the new one
        with pytest.raises(UnknownModel, match=r"is served \(lines\), got 'bows'"):
            client.plan(**fields, model="bows")
    assert client.plan(**fields).model.name == "lines"
    planning.engines.put(named(engine, "bows"))

    assert client.plan(**fields, model="bows").model.name == "bows"


def test_an_unloaded_default_is_replaced_by_no_other(
    client: ZenohAnchorClient, planning: PlanningService, engine: Any, fields: dict[str, Any]
) -> None:
    """As over HTTP, a request without a model is refused then."""
    assert client.plan(**fields).model.name == "lines"
    planning.engines.remove("lines")
    with pytest.raises(UnknownModel, match=r"is served \(bows\), got the default"):
        client.plan(**fields)
    assert client.plan(**fields, model="bows").model.name == "bows"
    planning.engines.remove("bows")
    with pytest.raises(UnknownModel, match="none at present"):
        client.plan(**fields)
    planning.engines.put(engine)

    assert client.plan(**fields).model.name == "lines"


def test_after_an_unload_at_one_replica_the_other_is_queried(
    start_router: Any, serve: Any, endpoint: str, engine: Any, fields: dict[str, Any]
) -> None:
    start_router()
    at_router = ZenohSettings(mode="client", connect=(endpoint,))
    services = {
        name: PlanningService({"lines": named(engine, "lines", name)}, default="lines")
        for name in "ab"
    }
    for name, service in services.items():
        serve(at_router, service, replica=name)
    with ZenohAnchorClient(endpoint, timeout_s=20) as client:
        answered: set[str] = set()
        while answered != {"a", "b"}:  # it knows both, and would ask either
            answered.add(client.plan(**fields).model.version)
        services["a"].engines.remove("lines")
        answered = {client.plan(**fields).model.version for _ in range(8)}

    assert answered == {"b"}


def test_a_model_that_is_unloaded_before_the_request_is_read_is_unknown(
    client: ZenohAnchorClient,
    planning: PlanningService,
    fields: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The service itself refuses, over the open query."""
    assert client.plan(**fields, model="bows").model.name == "bows"
    choose = planning.engines.choose

    def too_late(model: str | None) -> Any:
        monkeypatch.undo()
        planning.engines.remove("bows")
        return choose(model)

    monkeypatch.setattr(planning.engines, "choose", too_late)
    with pytest.raises(UnknownModel, match=r"\(lines\), got 'bows'"):
        client.plan(**fields, model="bows")


def test_a_request_that_is_planned_while_its_model_is_unloaded_is_answered(
    client: ZenohAnchorClient,
    planning: PlanningService,
    fields: dict[str, Any],
    caplog: pytest.LogCaptureFixture,
    until: Any,
) -> None:
    """Even if the client knows it, and would query another replica by now."""
    reached, opened = threading.Event(), threading.Event()

    def hold(batch: AnchorBatch) -> AnchorBatch:
        reached.set()
        assert opened.wait(PATIENCE_S)
        return batch

    bows: Any = planning.engines.choose("bows")
    bows.before_answer = hold
    with ThreadPoolExecutor(1) as executor:
        asked = executor.submit(lambda: client.plan(**fields, model="bows", budget_ms=4000))
        assert reached.wait(PATIENCE_S)
        planning.engines.remove("bows")
        with pytest.raises(UnknownModel):
            client.plan(**fields, model="bows")
        until(lambda: "a has not answered yet" in caplog.text or asked.done())
        opened.set()

        assert asked.result(PATIENCE_S).model.name == "bows"


def test_concurrent_changes_leave_the_keys_of_the_served_models(
    client: ZenohAnchorClient, planning: PlanningService, engine: Any, fields: dict[str, Any]
) -> None:
    def come_and_go(name: str) -> None:
        for _ in range(10):
            planning.engines.put(named(engine, name))
            planning.engines.remove(name)
        planning.engines.put(named(engine, name))

    threads = [threading.Thread(target=come_and_go, args=(name,)) for name in ("x", "y", "z")]
    for thread in threads:
        thread.start()
    answers = [client.plan(**fields).model.name for _ in range(20)]
    for thread in threads:
        thread.join()

    assert answers == ["lines"] * 20
    assert [client.plan(**fields, model=name).model.name for name in "xyz"] == ["x", "y", "z"]


def test_a_change_while_the_replica_leaves_is_no_error(
    planning: PlanningService, engine: Any, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    followers: list[Any] = []
    followed_by = planning.engines.followed_by

    def note(follower: Any) -> Any:
        followers.append(follower)
        return followed_by(follower)

    monkeypatch.setattr(planning.engines, "followed_by", note)
    joined = ZenohEndpoint(planning, open_session(ZenohSettings(listen=(endpoint,))))
    with start_blocking_portal() as portal, planning, portal.wrap_async_context_manager(joined):
        pass
    planning.engines.put(named(engine, "arcs"))
    (late,) = followers
    late()  # its session is closed: to declare a key there would be an error


def test_a_model_whose_name_is_not_allowed_in_a_key_is_served_over_http_alone(
    client: ZenohAnchorClient,
    planning: PlanningService,
    engine: Any,
    fields: dict[str, Any],
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        planning.engines.put(named(engine, "bows and lines"))

    assert "bows and lines is served over HTTP alone" in caplog.text
    assert client.plan(**fields).model.name == "lines"
