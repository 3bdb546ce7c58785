"""Reference pages say what the code says: every field, every error, every path."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, Field, PositiveFloat

from anchorflow_client import RequestError, TransportError
from anchorflow_client.contract.fields import DEFAULT_NUM_SAMPLES, REQUEST, V_MAX
from anchorflow_client.contract.request import MapScenes
from anchorflow_docs import reference
from anchorflow_docs.field_sources import (
    dataclass_section,
    field_docstrings,
    held_fields,
    model_section,
    request_fields,
    schema_fields,
)
from anchorflow_docs.tables import (
    HELD,
    Field as Row,
    endpoints,
    failures,
    field_table,
    refusals,
    table,
)
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.http.schemas import AnchorAnswerBody


class Inner(BaseModel):
    """What is inside; and more.

    This is not the first line.
    """

    low: float = Field(description="How low.", json_schema_extra={"x-unit": "m/s^2"})


class Outer(BaseModel):
    """A schema with one field of each kind."""

    points: list[float] | list[list[float]] = Field(
        description="Where it is.", json_schema_extra={"x-shape": "[2] or [B,2]", "x-unit": "m"}
    )
    method: Literal["a", "b"] | None = Field(None, description="One of two.")
    inner: Inner | None = Field(None, description="Said worse here.")


def test_a_schema_becomes_rows() -> None:
    assert schema_fields(Outer) == [
        Row("points", "`[2]` or `[B,2]`", "m", "", "Where it is."),
        Row("method", '`"a"`, `"b"`', "", "", "One of two."),
        Row("inner", "object", "", "", "What is inside; and more."),
        Row("inner.low", "number", "m/s²", "", "How low."),
    ]


def test_the_request_has_every_field_of_the_contract() -> None:
    rows = {row.path: row for row in request_fields(REQUEST)}

    assert [path for path in rows if "." not in path] == list(REQUEST.fields)
    assert rows["v_max"].allowed == f"(0, {V_MAX.high:g}] m/s"
    assert rows["num_samples"].value == f"`{DEFAULT_NUM_SAMPLES}`"
    assert rows["cost_map.resolution"].value == "required"
    assert rows["seed"].allowed == "[0, 2⁶³ − 1]"
    assert rows["sampler.schedule"].kind == '`[K]` or `"8step"` or `{"uniform": …}`'


def test_every_array_of_an_answer_says_its_shape() -> None:
    assert [row.path for row in schema_fields(AnchorAnswerBody) if "array" in row.kind] == []


def test_a_type_that_no_table_can_show_is_an_error() -> None:
    class Strange(BaseModel):
        """Has a field of any type."""

        anything: object

    with pytest.raises(ValueError, match="expected a type"):
        schema_fields(Strange)


class Part(BaseModel):
    """A model with one field of each kind."""

    kind: Literal["a"] = "a"
    """Which it is."""
    inside: tuple[Inner, ...]
    count: Annotated[int, Field(ge=2, lt=9)] = 3
    length: PositiveFloat | None
    """m."""
    told: dict[str, float] = Field(default_factory=dict)


def test_a_model_becomes_a_section() -> None:
    assert model_section(Part).split("\n") == [
        "## Part",
        "",
        "A model with one field of each kind.",
        "",
        "| field | type | range | default | meaning |",
        "| --- | --- | --- | --- | --- |",
        "| `kind` | `Literal['a']` |  | `'a'` | Which it is. |",
        "| `inside` | `tuple[Inner, ...]` |  | required |  |",
        "| `count` | `int` | ≥ 2, < 9 | `3` |  |",
        "| `length` | `float | None` |  | required | m. |",
        "| `told` | `dict[str, float]` |  | `{}` |  |",
    ]


def test_every_class_of_a_manifest_has_its_section() -> None:
    """`TensorSpec` stands among the Python types."""
    named = {"Manifest", *Manifest.model_json_schema()["$defs"]} - {"TensorSpec"}
    assert {kind.__name__ for kind in reference.ENTRIES} == named


@dataclass(frozen=True)
class Base:
    """The base."""

    first: int
    """The first."""


@dataclass(frozen=True)
class Derived(Base):
    """Derived, on
    two lines.

    Not shown.
    """

    second: str | None = None

    @property
    def both(self) -> str:
        """Together."""
        return f"{self.first}{self.second}"


def test_a_dataclass_becomes_a_section() -> None:
    assert dataclass_section(Derived).split("\n") == [
        "## Derived",
        "",
        "Derived, on two lines.",
        "",
        "| field | type | default | meaning |",
        "| --- | --- | --- | --- |",
        "| `first` | `int` | required | The first. |",
        "| `second` | `str | None` | `None` |  |",
        "",
        "| property | type | meaning |",
        "| --- | --- | --- |",
        "| `both` | `str` | Together. |",
    ]


@dataclass(frozen=True)
class Holder:
    """Holds one of each."""

    word: str
    share: float
    """A share."""
    times: tuple[float, ...]
    ranges: dict[str, tuple[float, float]]
    told: dict[str, float]
    inside: Base
    listed: tuple[Base, ...]
    is_there: bool = True


RANGES = {"v_max": (0.1, 6.0), "robot_radius": (0.0, 1.0)}


def test_an_instance_becomes_rows_of_what_it_holds() -> None:
    held = held_fields(
        Holder("a", 1 / 3, (0.0, 0.5, 1.0), RANGES, {"any": 0.9}, Base(7), (Base(8),))
    )

    assert field_table(held, HELD).split("\n") == [
        "| field | value | meaning |",
        "| --- | --- | --- |",
        "| `word` | `a` |  |",
        "| `share` | 0.3333 | A share. |",
        "| `times` | 0, 0.5, 1 |  |",
        "| `ranges` | `v_max` 0.1 to 6; `robot_radius` 0 to 1 |  |",
        "| `inside.first` | 7 | The first. |",
        "| `is_there` | `true` |  |",
    ]


@pytest.mark.parametrize("kind", reference.TYPES)
def test_docstrings_belong_to_fields(kind: type) -> None:
    assert set(field_docstrings(kind)) <= {field.name for field in fields(kind)}


def test_an_arrays_shape_stands_under_it() -> None:
    assert field_docstrings(MapScenes)["x_goal"].startswith("[B,2D]")


def test_bars_and_line_breaks_keep_to_their_cells() -> None:
    assert table(["a"], [["x | y\nz `p | q`"]]).split("\n")[-1] == r"| x \| y z `p | q` |"


def test_every_error_is_listed_with_its_status() -> None:
    listed = refusals()

    for kind in RequestError.__subclasses__():
        assert f"| `{kind.code}` | {kind.http_status} | `{kind.__name__}` |" in listed
    for kind in TransportError.__subclasses__():
        assert f"| `{kind.__name__}` |" in failures()


def test_every_path_is_listed_with_its_statuses() -> None:
    paths = {
        "/anchors": {
            "post": {
                "summary": "Plan Anchors",
                "description": "Plans.\n\nMore.",
                "responses": {"422": {}, "200": {}},
            }
        }
    }

    row = endpoints({"paths": paths}).split("\n")[-1]

    assert row == "| `POST /anchors` | Plans. | 200, 422 |"
