"""A planner without a cost map uses the same paths as one with a map.

The camera planner of tests/planners/ over JSON, binary, zenoh and the Open Inference Protocol, and
in batches.
"""

from __future__ import annotations

import base64
import io
import json
import re
import socket
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from anyio.from_thread import start_blocking_portal
from fastapi import FastAPI
from image_planner import HEIGHT, WIDTH, K, expected
from PIL import ExifTags, Image

from anchorflow_client import AnchorBatch, AnchorClient, JsonCodec, OipCodec
from anchorflow_client.contract import EncodedImage
from anchorflow_client.contract.fields import MAX_PIXELS, MAX_REQUEST_PIXELS
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.http import create_app
from anchorflow_service.http import orjson_codec as images
from anchorflow_service.http.orjson_codec import decoded
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_service.repository import BundleFolders, Repository
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

MODEL = "tiny-camera"
SPEED = 3.0
STATUS = np.array([SPEED, 0.0, 0.0, 0.0], np.float32)


def picture(grey: int) -> np.ndarray:
    return np.full((3, HEIGHT, WIDTH), grey, np.uint8)


def encoded(grey: int, image_format: str = "PNG", size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    return written(Image.new("RGB", size, (grey, grey, grey)), image_format)


def written(image: Image.Image, image_format: str = "PNG") -> bytes:
    data = io.BytesIO()
    image.save(data, image_format)
    return data.getvalue()


def assert_expected(anchors: AnchorBatch, grey: int, num_samples: int = K) -> None:
    paths, scores = expected(grey / 255, SPEED)
    np.testing.assert_allclose(anchors.trajectories, paths[:num_samples], atol=1e-5)
    np.testing.assert_allclose(anchors.scores, scores[:num_samples], atol=1e-4)
    assert (anchors.dt, anchors.first_s, anchors.model.name) == (0.5, 0.5, MODEL)


@pytest.fixture
def service_of_images(image_bundle: Path) -> PlanningService:
    engine = LocalClient.of(image_bundle, threads=1).engine
    return PlanningService({MODEL: engine}, default=MODEL, limits=ServiceLimits(threads=2))


@pytest.fixture
def app(service_of_images: PlanningService, image_bundle: Path) -> FastAPI:
    def opened(folder: Path) -> Any:
        return LocalClient.of(folder, threads=1).engine

    repository = Repository(service_of_images.engines, BundleFolders([image_bundle]), opened)
    return create_app(service_of_images, repository=repository)


@pytest.fixture(params=[JsonCodec(), OipCodec()], ids=["json", "binary"])
def client(request: pytest.FixtureRequest, service: Any) -> Iterator[AnchorClient]:
    with AnchorClient("http://test", transport=service, codec=request.param) as client:
        yield client


def test_the_best_come_first(client: AnchorClient) -> None:
    anchors = client.plan(inputs={"camera": picture(153), "ego_status": STATUS})

    assert list(anchors.arrays) == ["trajectories", "scores"]
    assert_expected(anchors, 153)
    assert anchors.best == 0
    with pytest.raises(LookupError, match="clearance: tiny-camera gives none"):
        _ = anchors.clearance


def test_num_samples_are_the_best_n(client: AnchorClient) -> None:
    inputs = {"camera": picture(40), "ego_status": STATUS}
    assert_expected(client.plan(inputs=inputs, num_samples=2), 40, num_samples=2)

    with pytest.raises(InvalidRequest, match=r"num_samples: expected 1 to 6, .* got 7"):
        client.plan(inputs=inputs, num_samples=7)


def test_extras_come_where_they_are_asked_for(client: AnchorClient) -> None:
    inputs = {"camera": picture(153), "ego_status": STATUS}
    anchors = client.plan(inputs=inputs, num_samples=3, outputs=["goals", "bev_semantics"])

    np.testing.assert_array_equal(anchors.arrays["goals"], anchors.trajectories[:, -1, :2])
    np.testing.assert_allclose(anchors.arrays["bev_semantics"], picture(153) / 255, rtol=1e-6)
    with pytest.raises(InvalidRequest, match=r"outputs: expected one of .*bev_semantics, got"):
        client.plan(inputs=inputs, outputs=["depth"])


def test_a_batch_equals_its_scenes_alone(client: AnchorClient) -> None:
    greys = (0, 100, 200, 255)
    cameras = np.stack([picture(grey) for grey in greys])
    together = client.plan(inputs={"camera": cameras, "ego_status": STATUS}, num_samples=4)

    assert together.trajectories.shape == (4, 4, 8, 3)
    for scene, camera in enumerate(cameras):
        alone = client.plan(inputs={"camera": camera, "ego_status": STATUS}, num_samples=4)
        for name, array in alone.arrays.items():
            assert together.arrays[name][scene].tobytes() == array.tobytes()


def test_the_card_says_how_to_ask(client: AnchorClient) -> None:
    (card,) = client.models()

    assert [spec.name for spec in card.inputs] == ["camera", "ego_status"]
    assert (card.conditioning.kind, card.sampler.kind, card.finish.kind) == (
        "tensors",
        "vocabulary",
        "none",
    )
    assert (card.T, card.D, card.time.first_s) == (8, 3, 0.5)
    with pytest.raises(InvalidRequest, match="tiny-camera takes no cost map; its inputs are cam"):
        _ = card.cost_map


ODD: dict[str, tuple[dict[str, Any], str]] = {
    "missing": ({"ego_status": None}, "inputs.ego_status: this field is required"),
    "unknown": ({"radar": [1.0]}, "inputs.radar: unknown field"),
    "another dtype": (
        {"camera": picture(3).astype(np.float32)},
        r"inputs.camera: expected uint8 \[3,16,24\] or \[B,3,16,24\], got an array of float32",
    ),
    "another shape": (
        {"camera": picture(3)[:, :8]},
        r"inputs.camera: expected shape \[3,16,24\] .*got an array of uint8 and shape \[3, 8, 24\]",
    ),
    "seven numbers": (
        {"ego_status": np.zeros(7, np.float32)},
        r"inputs.ego_status: expected shape \[4\] or \[B,4\], got .* shape \[7\]",
    ),
    "not a number": (
        {"ego_status": np.array([0, np.nan, 0, 0], np.float32)},
        r"expected finite numbers, got nan at inputs.ego_status\[1\]",
    ),
    "out of range": (
        {"ego_status": np.array([0, 0, 99, 0], np.float32)},
        r"expected numbers in \[-60, 60\] .*got 99.0 at inputs.ego_status\[2\]",
    ),
    "text": ({"ego_status": "fast"}, "inputs.ego_status: expected float32, got text"),
    "batches that differ": (
        {"camera": np.stack([picture(1)] * 2), "ego_status": np.stack([STATUS] * 3)},
        "inputs.ego_status: expected B = 2 as in inputs.camera, got 3",
    ),
}


@pytest.mark.parametrize("case", ODD)
def test_what_is_not_the_cards_is_refused_by_name(client: AnchorClient, case: str) -> None:
    change, words = ODD[case]
    inputs = {"camera": picture(3), "ego_status": STATUS, **change}
    inputs = {name: value for name, value in inputs.items() if value is not None}

    with pytest.raises(InvalidRequest, match=words) as caught:
        client.plan(inputs=inputs)
    assert str(caught.value.field) in words


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"v_max": 3.0}, "v_max"),
        ({"sampler": {"method": "rk4"}}, "sampler"),
        ({"refine": {"smooth": True}}, "refine"),
        ({"warm_start": {"trajectory": [[0, 0], [1, 1]]}}, "warm_start"),
    ],
)
def test_what_this_planner_has_no_use_for_is_refused(
    client: AnchorClient, fields: dict[str, Any], field: str
) -> None:
    with pytest.raises(InvalidRequest) as caught:
        client.plan(inputs={"camera": picture(3), "ego_status": STATUS}, **fields)
    assert caught.value.field == field


def test_a_map_is_refused(client: AnchorClient) -> None:
    with pytest.raises(InvalidRequest, match=r"cost_map: unknown to tiny-camera.* inputs\.camera"):
        client.plan(
            cost_map=np.zeros((16, 16)), resolution=0.5, x_curr=[0.0] * 6, x_goal=[1.0, 0, 0, 0]
        )


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
    data = io.BytesIO()
    Image.fromarray(lying).save(data, "PNG", exif=exif)

    pixels = decoded(EncodedImage("png", data.getvalue()), "camera")

    np.testing.assert_array_equal(pixels.transpose(1, 2, 0), UPRIGHT[orientation - 1](lying))


def test_a_picture_with_broken_exif_stays_as_it_lies() -> None:
    data = io.BytesIO()
    Image.new("RGB", (WIDTH, HEIGHT)).save(data, "JPEG", exif=b"Exif\0\0no TIFF")

    assert decoded(EncodedImage("jpeg", data.getvalue()), "camera").shape == (3, HEIGHT, WIDTH)


def base64_of(data: bytes) -> str:
    return base64.b64encode(data).decode()


def with_odd_exif() -> bytes:
    """On its side, with the name of a camera that lies beyond the end of the file."""
    entries = [(ExifTags.Base.Orientation, 3, 1, 6), (ExifTags.Base.Make, 2, 99, 900)]
    tiff = b"II*\0" + struct.pack("<IH", 8, len(entries))
    tiff += b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(4)
    data = io.BytesIO()
    Image.new("RGB", (HEIGHT, WIDTH)).save(data, "JPEG", exif=b"Exif\0\0" + tiff)
    return data.getvalue()


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


def test_the_filters_of_warnings_are_left_alone_while_a_picture_is_decoded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Threads share them."""
    before = warnings.filters
    during = []

    def upright(picture: Image.Image) -> Image.Image:
        during.append(warnings.filters)
        return picture

    monkeypatch.setattr(images, "_upright", upright)
    decoded(EncodedImage("png", encoded(9)), "camera")

    assert during[0] is before


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


def test_zenoh_carries_pixels(service_of_images: PlanningService) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
    session = open_session(ZenohSettings(listen=(endpoint,)))
    app = create_app(service_of_images, endpoints=[ZenohEndpoint(service_of_images, session)])
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
        ZenohAnchorClient(endpoint, timeout_s=20) as client,
    ):
        inputs = {"camera": picture(153), "ego_status": STATUS}
        assert_expected(client.plan(inputs=inputs), 153)
        assert client.models()[0].inputs[0].dtype == "uint8"
        with pytest.raises(InvalidRequest, match=r"inputs\.camera: this field is required"):
            client.plan(inputs={"ego_status": STATUS})


def test_any_client_of_the_protocol_may_ask(app: FastAPI, listen: Callable[[FastAPI], str]) -> None:
    triton = pytest.importorskip("tritonclient.http", reason="tritonclient[http] is missing")
    address = listen(app).removeprefix("http://")
    with triton.InferenceServerClient(address, network_timeout=20.0) as client:
        metadata = client.get_model_metadata(MODEL)
        camera = triton.InferInput("camera", [3, HEIGHT, WIDTH], "UINT8")
        camera.set_data_from_numpy(picture(153))
        status = triton.InferInput("ego_status", [4], "FP32")
        status.set_data_from_numpy(STATUS)
        wanted = [triton.InferRequestedOutput(name) for name in ("trajectories", "goals")]
        result = client.infer(MODEL, [camera, status], outputs=wanted)

    inputs = {each["name"]: (each["datatype"], each["shape"]) for each in metadata["inputs"]}
    assert inputs == {
        "camera": ("UINT8", [-1, 3, HEIGHT, WIDTH]),
        "ego_status": ("FP32", [-1, 4]),
    }
    outputs = {each["name"]: each["shape"] for each in metadata["outputs"]}
    assert outputs["trajectories"] == [-1, -1, 8, 3]
    assert (outputs["goals"], "safe" in outputs) == ([-1, -1, 2], False)
    paths = expected(0.6, SPEED)[0]
    np.testing.assert_allclose(result.as_numpy("trajectories"), paths, atol=1e-5)
    np.testing.assert_array_equal(
        result.as_numpy("goals"), result.as_numpy("trajectories")[:, -1, :2]
    )
    assert result.as_numpy("scores") is None
