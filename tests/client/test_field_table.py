"""The table of request fields makes the keywords of `plan`; a field added to it is everywhere."""

from __future__ import annotations

import inspect
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import anchorflow_client
from anchorflow_client import (
    AsyncAnchorClient,
    BaseAsyncClient,
    BaseClient,
    InvalidRequest,
    Planner,
)
from anchorflow_client.contract.fields import REQUEST

PLACE = {"resolution", "origin", "channel_weights"}
"""The place of a map that is given as an array."""
NOT_OF_UPDATE = {"request_id", "inputs", "delay_s", "last_plan"}
"""The planner gives its requests their ids, and plans on maps alone."""


def keywords_of(function: Any) -> dict[str, inspect.Parameter]:
    _, *parameters = inspect.signature(function).parameters.values()
    return {parameter.name: parameter for parameter in parameters}


@pytest.mark.parametrize("kind", [BaseClient, BaseAsyncClient])
def test_plan_has_every_field_as_a_keyword(kind: type[BaseClient | BaseAsyncClient]) -> None:
    keywords = keywords_of(kind.plan)

    assert set(keywords) == set(REQUEST.fields) | PLACE
    assert {each.kind for each in keywords.values()} == {inspect.Parameter.KEYWORD_ONLY}


def test_update_has_the_fields_of_planning_on_a_map() -> None:
    own = {"obstacles_age_s"}
    expected = (set(REQUEST.fields) | PLACE | own) - NOT_OF_UPDATE
    assert set(keywords_of(Planner.update)) == expected


def test_every_keyword_is_told_of() -> None:
    told = inspect.getdoc(BaseClient.plan) or ""

    missing = [name for name in keywords_of(BaseClient.plan) if f"    {name}: " not in told]
    assert missing == []


def test_an_async_refusal_comes_where_the_answer_is_awaited(fields: dict[str, Any]) -> None:
    """Or of two that are gathered, one would be made and never awaited."""
    client = AsyncAnchorClient("http://robot")
    fields["x_goal"] = [0, 0]

    refused = client.plan(**fields)

    with pytest.raises(InvalidRequest, match="x_goal"):
        refused.send(None)


TOP = """    made_up_m: Annotated[
        float | None, Number("A made-up distance.", Interval(0.0, 9.0, "m"), default=1.5)
    ]
"""
NESTED = """    made_up: Annotated[int | None, Number("A count.", NUM_SAMPLES, whole=True)] = None
"""
PROGRAM = """
import inspect, json
import numpy as np
from anchorflow_client import AnchorClient, AnchorRequest, InvalidRequest, JsonCodec, OipCodec
from anchorflow_client import Payload, Planner
from anchorflow_client.zenoh_messages import RequestAttachment
from anchorflow_client.contract.fields import REQUEST
from anchorflow_docs.field_sources import request_fields
from anchorflow_docs.tables import SENT, field_table
from anchorflow_service.http.openapi import request_schema
from anchorflow_service.http.orjson_codec import OrjsonCodec

asked = AnchorRequest.build(
    cost_map={"data": np.zeros((1, 16, 16)), "resolution": 0.5},
    x_curr=[0.0] * 6,
    x_goal=[1.0] * 2 + [0.0] * 2,
    made_up_m=2.5,
    refine={"made_up": 3},
)

def values(request):
    return [request.made_up_m, request.refine.made_up]

sent = OipCodec().encode_request(asked)
attached = RequestAttachment(header_length=sent.header_length).to_bytes()
received = Payload(sent.body, RequestAttachment.from_bytes(attached).header_length)
try:
    AnchorRequest.build(inputs={"a": 1}, made_up_m=10)
except InvalidRequest as error:
    refusal = error.message
fields = request_schema()["properties"]
reference = field_table(request_fields(REQUEST), SENT).splitlines()
print(json.dumps({
    "json": values(OrjsonCodec().decode_request(JsonCodec().encode_request(asked))),
    "binary": values(OipCodec().decode_request(sent)),
    "zenoh": values(OipCodec().decode_request(received)),
    "refusal": refusal,
    "keywords": ["made_up_m" in inspect.signature(each).parameters
                 for each in (AnchorClient.plan, Planner.update)],
    "help": "made_up_m: A made-up distance." in AnchorClient.plan.__doc__,
    "openapi": [fields["made_up_m"], fields["refine"]["anyOf"][0]["properties"]["made_up"]],
    "reference": [line for line in reference if "made_up" in line],
}))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Run a program with one more field in the table, and one more in `refine`."""
    folder = tmp_path_factory.mktemp("client")
    package = folder / "anchorflow_client"
    shutil.copytree(Path(anchorflow_client.__file__).parent, package)
    table = package / "contract" / "fields.py"
    source = table.read_text()
    for before, row in (
        ("    robot_id: Annotated[", TOP),
        ("\n\n@dataclass(frozen=True, eq=False)\nclass WarmStart", NESTED),
    ):
        assert source.count(before) == 1
        source = source.replace(before, row + before)
    table.write_text(source)
    path = os.pathsep.join([str(folder), *sys.path])
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


@pytest.mark.parametrize("form", ["json", "binary", "zenoh"])
def test_every_form_of_a_request_carries_it(found: dict[str, Any], form: str) -> None:
    assert found[form] == [2.5, 3]


def test_it_is_checked_by_its_range(found: dict[str, Any]) -> None:
    assert found["refusal"] == "made_up_m: expected a number in [0, 9] m, got 10"


def test_plan_and_update_take_it_as_a_keyword(found: dict[str, Any]) -> None:
    assert found["keywords"] == [True, True]
    assert found["help"]


def test_openapi_has_what_the_form_of_the_page_is_made_of(found: dict[str, Any]) -> None:
    number, count = found["openapi"]

    assert number == {
        "description": "A made-up distance.",
        "default": 1.5,
        "x-unit": "m",
        "anyOf": [{"type": "number", "minimum": 0.0, "maximum": 9.0}, {"type": "null"}],
    }
    assert count["anyOf"][0] == {"type": "integer", "minimum": 1, "maximum": 512}


def test_the_reference_has_a_row_of_it(found: dict[str, Any]) -> None:
    assert found["reference"] == [
        "| `refine.made_up` | integer | [1, 512] |  | A count. |",
        "| `made_up_m` | number | [0, 9] m | `1.5` | A made-up distance. |",
    ]
