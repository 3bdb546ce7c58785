"""Arrays of a JSON request as bytes, and a map as a picture: the same request as with lists."""

from __future__ import annotations

import base64
import io
import json
from typing import Any

import numpy as np
import pytest
from PIL import Image

from anchorflow_client import (
    AnchorRequest,
    CostMap,
    InvalidRequest,
    JsonCodec,
    Payload,
)
from anchorflow_service.http.orjson_codec import OrjsonCodec

GRID = np.random.default_rng(0).integers(0, 127, (16, 20)).astype(np.uint8)


def as_bytes(value: Any, dtype: str = "float64") -> dict[str, Any]:
    array = np.asarray(value, dtype)
    data = base64.b64encode(array.tobytes()).decode()
    return {"dtype": dtype, "shape": list(array.shape), "base64": data}


def png(grid: np.ndarray, mode: str = "L") -> dict[str, str]:
    file = io.BytesIO()
    Image.fromarray(grid).convert(mode).save(file, "png")
    return {"png": base64.b64encode(file.getvalue()).decode()}


def read(fields: dict[str, Any], codec: type[JsonCodec] = OrjsonCodec) -> AnchorRequest:
    return codec().decode_request(Payload(json.dumps(fields).encode()))


@pytest.mark.parametrize("dtype", ["bool", "uint8", "int64", "float32"])
def test_a_map_may_be_bytes_of_any_type(fields: dict[str, Any], dtype: str) -> None:
    grid = (GRID[None] > 120).astype(dtype)

    fields["cost_map"]["data"] = as_bytes(grid, dtype)

    np.testing.assert_array_equal(read(fields).cost_map.data[0], grid.astype(np.float32))


def test_a_map_may_be_a_greyscale_png(fields: dict[str, Any]) -> None:
    fields["cost_map"]["data"] = png(GRID)

    data = read(fields).cost_map.data

    assert data.dtype == np.float32
    np.testing.assert_array_equal(data, [[GRID.astype(np.float32) / np.float32(255)]])


@pytest.mark.parametrize(
    ("path", "value", "field", "words"),
    [
        ("data", png(GRID, "RGB"), "cost_map.data.png", "greyscale picture, .*got mode RGB"),
        ("data", png(GRID, "LA"), "cost_map.data.png", "got mode LA"),
        ("data", png(GRID[:8]), "cost_map.data", "from 16 to 512, got 8 and 20"),
        ("data", png(GRID + np.uint8(128)), "x_curr", "occupancy below 0.5"),
        ("data", {"png": "!"}, "cost_map.data.png", "expected base64"),
        ("data", {"png": "aGk="}, "cost_map.data.png", "2 bytes that cannot be read"),
        ("data", {"png": 7}, "cost_map.data.png", "a string of base64, got 7"),
        ("origin", as_bytes([0.0, 0.0, 0.0]), "cost_map.origin", r"\[2\], got \[3\]"),
        ("origin", {"dtype": "float64"}, "cost_map.origin.shape", "required"),
        ("origin", as_bytes([0, 1], "bool"), "cost_map.origin", "expected numbers"),
        ("data", as_bytes(np.full((1, 16, 20), 2.0)), "cost_map.data", r"in \[0, 1\], got 2.0"),
        (
            "data",
            as_bytes(GRID[None] / 255) | {"shape": [1, 16, 21]},
            "cost_map.data.base64",
            "2688 bytes",
        ),
    ],
)
def test_a_bad_form_is_refused_by_its_field(
    fields: dict[str, Any], path: str, value: Any, field: str, words: str
) -> None:
    fields["cost_map"][path] = value

    with pytest.raises(InvalidRequest, match=words) as caught:
        read(fields)
    assert caught.value.field == field


def test_the_client_decodes_no_picture() -> None:
    with pytest.raises(InvalidRequest, match=r"got a PNG, which a service decodes") as caught:
        CostMap.build(png(GRID), 0.5)
    assert caught.value.field == "cost_map.data.png"
