"""Pictures in requests: files as base64, nested lists, and the tensors of the protocol's client."""

from __future__ import annotations

import base64
import io
import json
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from image_planner import HEIGHT, WIDTH
from PIL import ExifTags, Image
from served import app_of

from anchorflow_client import AnchorClient, JsonCodec
from anchorflow_client.contract import EncodedImage
from anchorflow_client.contract.fields import MAX_PIXELS, MAX_REQUEST_PIXELS
from anchorflow_service.http.orjson_codec import decoded

MODEL = "tiny-camera"
SPEED = 3.0
STATUS = np.array([SPEED, 0.0, 0.0, 0.0], np.float32)


def picture(grey: int) -> np.ndarray:
    return np.full((3, HEIGHT, WIDTH), grey, np.uint8)


def encoded(grey: int, image_format: str = "PNG", size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    return written(Image.new("RGB", size, (grey, grey, grey)), image_format)


def written(image: Image.Image, image_format: str = "PNG", **options: Any) -> bytes:
    data = io.BytesIO()
    image.save(data, image_format, **options)
    return data.getvalue()


@pytest.fixture
def app(image_bundle: Path) -> FastAPI:
    return app_of(image_bundle)


def post(service: Any, camera: Any, status: Any = (SPEED, 0, 0, 0)) -> Any:
    return service.post({"inputs": {"camera": camera, "ego_status": status}, "num_samples": 1})


@pytest.mark.parametrize("image_format", ["png", "jpeg"])
def test_a_picture_may_be_a_file(service: Any, image_format: str) -> None:
    data = encoded(153, image_format.upper())

    answer = post(service, {image_format: base64.b64encode(data).decode()})

    assert answer.status_code == 200, answer.text
    np.testing.assert_allclose(answer.json()["scores"], [0.0], atol=1e-3)
    with AnchorClient("http://test", transport=service, codec=JsonCodec()) as client:
        image = EncodedImage(image_format, data)
        anchors = client.plan(inputs={"camera": image, "ego_status": STATUS})
    np.testing.assert_allclose(anchors.scores[0], 0.0, atol=1e-3)


UPRIGHT: list[Callable[[np.ndarray], np.ndarray]] = [
    lambda lying: lying,
    np.fliplr,
    lambda lying: np.rot90(lying, 2),
    np.flipud,
    lambda lying: lying.swapaxes(0, 1),
    lambda lying: np.rot90(lying, -1),
    lambda lying: np.rot90(lying, 2).swapaxes(0, 1),
    np.rot90,
]
"""Indexed by the EXIF orientation − 1."""


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_turned_as_its_exif_says(orientation: int) -> None:
    lying = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    data = written(Image.fromarray(lying), exif=exif)

    pixels = decoded(EncodedImage("png", data), "camera")

    np.testing.assert_array_equal(pixels.transpose(1, 2, 0), UPRIGHT[orientation - 1](lying))


def test_a_picture_with_broken_exif_stays_as_it_lies() -> None:
    data = written(Image.new("RGB", (WIDTH, HEIGHT)), "JPEG", exif=b"Exif\0\0no TIFF")

    assert decoded(EncodedImage("jpeg", data), "camera").shape == (3, HEIGHT, WIDTH)


def base64_of(data: bytes) -> str:
    return base64.b64encode(data).decode()


def with_odd_exif() -> bytes:
    """On its side, with the name of a camera that lies beyond the end of the file."""
    entries = [(ExifTags.Base.Orientation, 3, 1, 6), (ExifTags.Base.Make, 2, 99, 900)]
    tiff = b"II*\0" + struct.pack("<IH", 8, len(entries))
    tiff += b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(4)
    return written(Image.new("RGB", (HEIGHT, WIDTH)), "JPEG", exif=b"Exif\0\0" + tiff)


def with_half_transparent_colours() -> bytes:
    image = Image.new("P", (WIDTH, HEIGHT))
    image.putpalette(range(9))
    image.info["transparency"] = bytes([0, 128, 255])
    return written(image)


@pytest.mark.parametrize(
    "camera",
    [
        {"jpeg": base64_of(with_odd_exif())},
        {"png": base64_of(with_half_transparent_colours())},
    ],
    ids=lambda camera: next(iter(camera)),
)
def test_what_pillow_warns_of_is_taken_and_not_told(service: Any, camera: Any) -> None:
    """Here a warning would be an error."""
    answer = post(service, camera)

    assert answer.status_code == 200, answer.text


def without_palette() -> bytes:
    image = Image.new("P", (WIDTH, HEIGHT))
    image.info["transparency"] = 0
    png = written(image)
    start = png.index(b"PLTE") - 4
    return png[:start] + png[start + 12 + int.from_bytes(png[start : start + 4], "big") :]


def with_an_empty_profile() -> bytes:
    png = encoded(9)
    chunk = bytes(4) + b"iCCP" + zlib.crc32(b"iCCP").to_bytes(4, "big")
    return png[:-12] + chunk + png[-12:]  # in front of IEND


def of_side(pixels: int) -> bytes:
    """A picture that says of itself to be that large."""
    png = encoded(9)
    header = b"IHDR" + 2 * pixels.to_bytes(4, "big") + png[24:29]
    return png[:12] + header + zlib.crc32(header).to_bytes(4, "big") + png[33:]


BAD_FILES: dict[str, tuple[Any, str]] = {
    "no base64": ({"png": "%%%"}, "inputs.camera.png: expected base64"),
    "no picture": (
        {"png": base64_of(b"GIF89a")},
        "inputs.camera.png: expected a png file, got 6 bytes that cannot be read as one$",
    ),
    "no palette": (
        {"png": base64_of(without_palette())},
        "inputs.camera.png: expected a png file",
    ),
    "an empty profile": (
        {"png": base64_of(with_an_empty_profile())},
        "inputs.camera.png: expected a png file",
    ),
    "16 bits": (
        {"png": base64_of(written(Image.new("I;16", (WIDTH, HEIGHT), 40_000)))},
        "inputs.camera.png: expected 8 bits a channel, got mode I;16",
    ),
    "cut off": (
        {"jpeg": base64_of(encoded(9, "JPEG", (400, 400))[:-300])},
        "inputs.camera.jpeg: expected a jpeg file",
    ),
    "another format": (
        {"png": base64_of(encoded(9, "JPEG"))},
        "inputs.camera.png: expected a png file",
    ),
    "a bomb": (
        {"png": base64_of(written(Image.new("1", (10_000, 10_000))))},
        f"inputs.camera.png: expected a picture of at most {MAX_PIXELS} pixels, got 10000 x 10000",
    ),
    "a bomb that Pillow would refuse": (
        {"png": base64_of(of_side(14_000))},
        f"inputs.camera.png: expected a picture of at most {MAX_PIXELS} pixels, got 14000 x 14000",
    ),
    "short of bytes": (
        {"dtype": "uint8", "shape": [3, 16, 24], "base64": base64_of(b"\0" * 5)},
        r"inputs.camera.base64: expected 1152 bytes for uint8 \[3, 16, 24\], got 5",
    ),
    "a strange dtype": (
        {"dtype": "object", "shape": [1], "base64": ""},
        "inputs.camera.dtype: expected one of bool, uint8, int64, float32, float64",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_broken_picture_is_refused_by_name(service: Any, case: str) -> None:
    camera, words = BAD_FILES[case]
    answer = post(service, camera)

    assert answer.status_code == 422, answer.text
    error = answer.json()["error"]
    assert re.match(words, error["message"])
    assert error["field"] == words.partition(":")[0]


@pytest.mark.parametrize("path", ["/anchors", "/page/flow"])
def test_the_pictures_of_a_request_are_bounded_together(service: Any, path: str) -> None:
    """Each is small enough by itself, and none is the card's: a file of 2 kB unpacks to 48 MB."""
    largest = {"png": base64_of(written(Image.new("1", (4096, 4096))))}
    inputs = {f"camera_{index}": largest for index in range(3)}

    error = service.request("POST", path, content=json.dumps({"inputs": inputs})).json()["error"]

    assert error["field"] == "inputs.camera_2.png"
    assert f"pictures of at most {MAX_REQUEST_PIXELS} pixels together" in error["message"]


def test_nested_lists_are_numbers_of_the_cards_type(service: Any) -> None:
    answer = post(service, picture(153).tolist())
    assert answer.status_code == 200
    np.testing.assert_allclose(answer.json()["scores"], [0.0], atol=1e-5)

    for stray in (0.5, 256):
        strange = picture(153).tolist()
        strange[2][0][7] = stray
        refused = post(service, strange).json()["error"]
        assert refused["field"] == "inputs.camera"
        message = f"expected uint8 numbers, got {float(stray)} at inputs.camera[2][0][7]"
        assert refused["message"] == message


def test_the_protocols_metadata_are_the_cards_own_tensors(service: Any) -> None:
    metadata = service.request("GET", f"/v2/models/{MODEL}").json()

    inputs = {each["name"]: (each["datatype"], each["shape"]) for each in metadata["inputs"]}
    assert inputs == {
        "camera": ("UINT8", [-1, 3, HEIGHT, WIDTH]),
        "ego_status": ("FP32", [-1, 4]),
    }
    outputs = {each["name"]: each["shape"] for each in metadata["outputs"]}
    assert outputs["trajectories"] == [-1, -1, 8, 3]
    assert (outputs["goals"], "safe" in outputs) == ([-1, -1, 2], False)
