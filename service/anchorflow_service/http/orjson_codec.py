"""The service's JSON codec: orjson for speed, and Pillow for pictures in requests."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from anchorflow_client import codec as json_codec
from anchorflow_client.codec import JsonCodec, Payload, as_bytes, not_json
from anchorflow_client.contract import AnchorRequest, EncodedImage
from anchorflow_client.contract.checks import bytes_of_base64
from anchorflow_client.contract.fields import MAX_PIXELS, MAX_REQUEST_PIXELS
from anchorflow_client.errors import InvalidRequest

# The standard library reads these and orjson does not: NaN, Infinity, numbers beyond float64.
_NOT_FINITE = re.compile(r"NaN|Infinity|[-\d]")


def dump(value: Any) -> bytes:
    """Write plain types and numpy arrays as JSON; a number that is not finite becomes null."""
    return orjson.dumps(value, default=_contiguous, option=orjson.OPT_SERIALIZE_NUMPY)


def parse(body: bytes) -> Any:
    """Parse as `json_codec.parse` does. Raises `InvalidRequest`."""
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError as error:
        if _NOT_FINITE.match(error.doc, error.pos):
            # Parsed again by a parser that accepts them, so that the error names their field.
            return json_codec.parse(body)
        raise not_json(error.msg, error.pos, len(body)) from error


class OrjsonCodec(JsonCodec):
    """The contract as JSON in the service, which decodes pictures."""

    def decode_request(self, payload: Payload) -> AnchorRequest:
        return with_pixels(AnchorRequest.from_fields(with_map(self._load(payload.body))))

    def _dump(self, value: dict[str, Any]) -> bytes:
        return orjson.dumps(value, default=as_bytes) if self._base64 else dump(value)

    def _load(self, body: bytes) -> Any:
        return parse(body)


def _contiguous(value: Any) -> Any:
    """Copy an array to C order, the only one that orjson writes."""
    if isinstance(value, np.ndarray) and not value.flags.c_contiguous:
        return np.ascontiguousarray(value)
    raise TypeError(f"cannot write a {type(value).__name__} as JSON")


# `Image.open` would check the size first, with a limit of its own.
_READERS = {"png": PngImageFile, "jpeg": JpegImageFile}


def ignore_warnings_of_pillow() -> None:
    """Ignore Pillow's warnings, of odd EXIF for example, in the whole process.

    Called once: threads share the filters, so `warnings.catch_warnings` is not safe in them.
    """
    warnings.filterwarnings("ignore", category=UserWarning, module=r"PIL\.")


def with_pixels(request: AnchorRequest) -> AnchorRequest:
    """Return the request with its pictures decoded. Raises `InvalidRequest` naming the input."""
    pictures: dict[str, NDArray[np.uint8]] = {}
    num_pixels = 0
    for name, value in request.inputs.items():
        if isinstance(value, EncodedImage):
            field = f"inputs.{name}.{value.format}"
            pictures[name] = decoded(value, field, num_before=num_pixels)
            num_pixels += pictures[name][0].size
    return replace(request, inputs={**request.inputs, **pictures}) if pictures else request


def with_map(body: Any) -> Any:
    """Return a request's JSON with {"png": …} in cost_map.data decoded to float32 [1,H,W].

    The values 0 to 255 of a greyscale picture become 0 to 1; its first row is the map's first.
    Raises `InvalidRequest`.
    """
    match body:
        case {"cost_map": {"data": {"png": png, **others}} as cost_map} if not others:
            field = "cost_map.data.png"
            image = EncodedImage("png", bytes_of_base64(png, field))
            grid = _pixels(image, field, _grey, 0).astype(np.float32) / np.float32(255)
            return {**body, "cost_map": {**cost_map, "data": grid[None]}}
    return body


def decoded(image: EncodedImage, field: str, *, num_before: int = 0) -> NDArray[np.uint8]:
    """Return the pixels [3,H,W] of a picture: RGB, turned as its EXIF says.

    num_before: pixels of the request's other pictures so far

    Raises:
        InvalidRequest: it is no file of that format, is broken, has more than 8 bits a channel,
            or has more than MAX_PIXELS, or with the others more than MAX_REQUEST_PIXELS; the size
            is checked before anything is decoded.
    """
    pixels = _pixels(image, field, lambda picture, _: _upright(picture.convert("RGB")), num_before)
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _pixels(
    image: EncodedImage,
    field: str,
    convert: Callable[[Image.Image, str], Image.Image],
    num_before: int,
) -> NDArray[np.uint8]:
    try:
        with _READERS[image.format](io.BytesIO(image.data)) as picture:
            _check(picture, field, num_before)
            return np.asarray(convert(picture, field))
    except InvalidRequest:
        raise
    except Exception as error:  # Pillow raises any kind of error for broken files
        came = f"{len(image.data)} bytes that cannot be read as one"
        raise InvalidRequest(f"expected a {image.format} file, got {came}", field) from error


def _grey(picture: Image.Image, field: str) -> Image.Image:
    if picture.mode not in ("1", "L"):
        came = f"got mode {picture.mode}"
        raise InvalidRequest(
            f"expected a greyscale picture, one channel without alpha, {came}", field
        )
    return picture.convert("L")


def _upright(picture: Image.Image) -> Image.Image:
    """Turn a picture as its EXIF says; if that is broken, leave it, as browsers do."""
    with suppress(Exception):  # Pillow raises any kind of error
        ImageOps.exif_transpose(picture, in_place=True)
    return picture


def _check(picture: Image.Image, field: str, num_before: int) -> None:
    """Check a picture before it is decoded. Raises `InvalidRequest`."""
    width, height = picture.size
    if width * height > MAX_PIXELS:
        most = f"a picture of at most {MAX_PIXELS} pixels"
        raise InvalidRequest(f"expected {most}, got {width} x {height}", field)
    if num_before + width * height > MAX_REQUEST_PIXELS:
        most = f"pictures of at most {MAX_REQUEST_PIXELS} pixels together"
        came = f"{width} x {height} beside {num_before} pixels"
        raise InvalidRequest(f"expected {most}, got {came}", field)
    if picture.mode.startswith(("I", "F")):  # `convert` would clip these at 255
        raise InvalidRequest(f"expected 8 bits a channel, got mode {picture.mode}", field)
