"""V2X-VLM from torch to a bundle, and through the whole service: JSON, binary and zenoh.

One bundle, exported once, for everything that needs one.
"""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from exported_bundles import export_once
from PIL import Image
from served import TRANSPORTS, client_over
from small_v2x import IMAGE_SIZE, PROMPTS, small_sizes
from starlette.testclient import TestClient

from anchorflow_benchmarks.driving.pairs import (
    judged_crossings,
    pair_tables,
    planned,
    planner_of_bundle,
)
from anchorflow_client import AnchorBatch, EncodedImage
from anchorflow_client.contract.fields import MAX_INPUT_TEXT_LENGTH, MAX_PIXELS
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import resized
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners.v2x_vlm import v2x_vlm_adapter
from anchorflow_export.tracing import ExportError
from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_models.v2x_vlm.network import poses
from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.engine.conditioning import vision_language
from anchorflow_service.engine.engine import Engine
from anchorflow_service.engine.samplers.vocabulary import VocabularySampler
from anchorflow_service.http import create_app
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_training.v2x.text import opened

MODEL = "small-v2x-vlm"
SIZE = (90, 70)  # H, W of the pictures that are sent
SQUARE = (IMAGE_SIZE, IMAGE_SIZE)


@pytest.fixture(scope="module")
def model() -> Iterator[V2XVLM]:
    with small_sizes():
        yield export_once("v2x_vlm").network


@pytest.fixture(scope="module")
def bundle() -> Path:
    return export_once("v2x_vlm").path


@pytest.fixture(scope="module")
def engine(bundle: Path) -> Engine:
    return LocalClient.of(bundle, threads=1).engine


@pytest.fixture(scope="module")
def http(engine: Engine) -> Iterator[TestClient]:
    planning = PlanningService({MODEL: engine}, default=MODEL, limits=ServiceLimits(threads=1))
    with TestClient(create_app(planning)) as client:
        yield client


def picture(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (3, *size), dtype=np.uint8)


def inputs(seed: int = 0) -> dict[str, Any]:
    return {
        "vehicle_image": picture(seed),
        "infrastructure_image": picture(seed + 100, (60, 110)),
        "prompt": PROMPTS[3],
    }


def wanted(model: V2XVLM, asked: dict[str, Any]) -> np.ndarray:
    """[1,45,3], by torch alone."""

    def look(name: str) -> torch.Tensor:
        return model.look(torch.from_numpy(resized(asked[name], IMAGE_SIZE))[None])

    there = "infrastructure_image" in asked
    tokens = torch.tensor([opened(model.tokenizer).encode(asked["prompt"]).ids])
    with torch.no_grad():
        first = look("vehicle_image")
        second = look("infrastructure_image") if there else first
        fused = model.fuse(first, second, torch.tensor([there]), tokens)
        return poses(model.drive(fused)).numpy()


def test_the_card_says_how_to_ask(bundle: Path) -> None:
    card = load_bundle(bundle).card
    assert [(spec.name, spec.dtype, spec.optional) for spec in card.inputs] == [
        ("vehicle_image", "uint8", False),
        ("infrastructure_image", "uint8", True),
        ("prompt", "text", False),
    ]
    assert (card.conditioning.kind, card.sampler.kind) == ("vision_language", "vocabulary")
    assert (card.T, card.D, card.time.first_s, card.time.dt) == (45, 3, 0.1, 0.1)


@pytest.mark.parametrize("without", [(), ("infrastructure_image",)])
def test_an_answer_is_torchs(engine: Engine, model: V2XVLM, without: tuple[str, ...]) -> None:
    asked = {name: value for name, value in inputs().items() if name not in without}
    anchors = LocalClient(engine).plan(inputs=asked)

    np.testing.assert_allclose(anchors.trajectories, wanted(model, asked), atol=1e-4)
    assert list(anchors.arrays) == ["trajectories"]
    assert (anchors.dt, anchors.first_s, anchors.absent_inputs) == (0.1, 0.1, without)


def assert_same(anchors: AnchorBatch, other: AnchorBatch) -> None:
    np.testing.assert_array_equal(anchors.trajectories, other.trajectories)
    assert anchors.absent_inputs == other.absent_inputs


@pytest.mark.parametrize("without", [(), ("infrastructure_image",)])
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_every_way_in_gives_the_same(
    engine: Engine, transport: str, without: tuple[str, ...]
) -> None:
    """JSON carries pictures as files, the others as arrays."""
    asked = {name: value for name, value in inputs(2).items() if name not in without}
    files = {n: v if n == "prompt" else EncodedImage("png", encoded(v)) for n, v in asked.items()}
    planning = PlanningService({MODEL: engine}, default=MODEL, limits=ServiceLimits(threads=1))
    with client_over(transport, planning) as client:
        anchors = client.plan(inputs=files if transport == "json" else asked)
        (card,) = client.models()
    assert_same(anchors, LocalClient(engine).plan(inputs=asked))
    assert anchors.absent_inputs == without
    assert card.inputs[1].optional


def test_a_smaller_request_has_the_same_answer(engine: Engine) -> None:
    client, asked = LocalClient(engine), inputs(4)
    before = client.plan(inputs=asked)
    for name in ("vehicle_image", "infrastructure_image"):
        asked[name] = resized(asked[name], IMAGE_SIZE)
    assert_same(client.plan(inputs=asked), before)


def views_of(engine: Engine) -> Any:
    assert isinstance(engine.sampler, VocabularySampler)
    return engine.sampler.views


def test_the_roadside_picture_is_looked_at_once(bundle: Path) -> None:
    engine = LocalClient.of(bundle, threads=1).engine
    looks = views_of(engine)
    seen, run = [], looks._graphs.run

    def counted(role: str, given: Any, *, threads: int = 1) -> Any:
        if role == "vision":
            seen.append(given)
        return run(role, given, threads=threads)

    looks._graphs.run = counted
    client, asked = LocalClient(engine), inputs(5)
    first = client.plan(inputs=asked)
    assert len(seen) == 2
    assert_same(client.plan(inputs=asked), first)
    assert len(seen) == 3  # the car's own picture alone
    asked["infrastructure_image"] = asked["infrastructure_image"].copy()
    asked["infrastructure_image"][0, 0, 0] ^= 1
    client.plan(inputs=asked)
    assert len(seen) == 5


def test_what_is_remembered_is_bounded(bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = LocalClient.of(bundle, threads=1).engine
    looks = views_of(engine)
    monkeypatch.setattr(vision_language, "MEMORY", 3 * looks._nothing.nbytes)
    for seed in range(6):
        LocalClient(engine).plan(inputs=inputs(seed))
    assert looks.remembered == 3


def encoded(pixels: np.ndarray, form: str = "PNG") -> bytes:
    data = io.BytesIO()
    Image.fromarray(pixels.transpose(1, 2, 0)).save(data, form)
    return data.getvalue()


def base64_of(data: bytes) -> str:
    return base64.b64encode(data).decode()


HUGE = base64_of(encoded(np.broadcast_to(np.uint8(0), (3, 4200, 4200))))
BAD: dict[str, tuple[str, Any, str]] = {
    "a broken JPEG": (
        "vehicle_image",
        {"jpeg": base64_of(encoded(picture(1, (300, 400)), "JPEG")[:-900])},
        "inputs.vehicle_image.jpeg: expected a jpeg file",
    ),
    "17 megapixels": (
        "infrastructure_image",
        {"png": HUGE},
        f"inputs.infrastructure_image.png: expected a picture of at most {MAX_PIXELS} pixels, got",
    ),
    "100 kB of text": (
        "prompt",
        "word " * 20_000,
        f"inputs.prompt: expected a text of at most {MAX_INPUT_TEXT_LENGTH} characters, got 100000",
    ),
    "too many tokens": (
        "prompt",
        "7" * 1000,
        "inputs.prompt: expected a text of at most 64 tokens, got 1002",
    ),
    "another dtype": (
        "vehicle_image",
        {"dtype": "float32", "shape": [3, 2, 2], "base64": base64_of(bytes(48))},
        r"inputs.vehicle_image: expected uint8 \[3,H,W\] or \[B,3,H,W\], got an array of float32",
    ),
    "no text": ("prompt", [1.0], "inputs.prompt: expected text, got an array"),
    "no picture of the car": ("vehicle_image", None, "inputs.vehicle_image: this field is requ"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_request_is_refused_by_name(http: TestClient, case: str) -> None:
    name, value, words = BAD[case]
    asked: dict[str, Any] = {"vehicle_image": {"png": base64_of(encoded(picture(1)))}}
    asked |= {"prompt": PROMPTS[0], name: value}

    answer = http.post("/anchors", json={"inputs": asked})

    assert answer.status_code == 422, answer.text
    error = answer.json()["error"]
    assert error["code"] == "invalid_request"
    assert re.match(words, error["message"]), error["message"]
    assert error["field"] == words.partition(":")[0]


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.broadcast_to(np.uint8(0), (3, 5000, 5000)), "expected a picture of at most"),
        (EncodedImage("png", encoded(picture(1))), "expected uint8; no picture is decod"),
    ],
    ids=["25 megapixels", "a file, which is decoded before the engine"],
)
def test_a_picture_that_the_engine_does_not_take(engine: Engine, image: Any, words: str) -> None:
    with pytest.raises(InvalidRequest, match=f"vehicle_image: {words}"):
        LocalClient(engine).plan(inputs={"vehicle_image": image, "prompt": "x"})


def test_without_its_extra_a_bundle_says_what_to_install(
    bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tokenizers", None)
    with pytest.raises(BundleError, match=r"pip install 'anchorflow\[language\]'"):
        Engine(load_bundle(bundle))


def test_another_tokenizer_is_found_out(bundle: Path, tmp_path: Path) -> None:
    broken = shutil.copytree(bundle, tmp_path / "bundle")
    (broken / "tokenizer.json").write_bytes(b"{}")
    with pytest.raises(BundleError, match=r"tokenizer\.json: its sha256 is"):
        load_bundle(broken)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m["files"].clear(), "files: expected tokenizer"),
        (lambda m: m["conditioning"].update(text="words"), "expected words of text among request"),
        (
            lambda m: m["conditioning"].update(images=["vehicle_image"]),
            "graphs.encode.inputs: expected has_infrastructure_image, tokens",
        ),
        (lambda m: m["graphs"].pop("vision"), "needs the role vision"),
        (lambda m: m["request"]["inputs"][1].update(optional=False), "graphs.encode.inputs"),
    ],
)
def test_parts_that_do_not_fit_are_told(
    bundle: Path, tmp_path: Path, change: Any, words: str
) -> None:
    broken = shutil.copytree(bundle, tmp_path / "bundle")
    manifest = json.loads((broken / "manifest.json").read_text())
    change(manifest)
    (broken / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match=re.escape(words)):
        LocalClient.of(broken, threads=1)


def test_a_network_without_a_tokenizer_is_not_exported(model: V2XVLM) -> None:
    tokenizer, model.tokenizer = model.tokenizer, b""
    try:
        with pytest.raises(ExportError, match="expected a network with its tokenizer"):
            v2x_vlm_adapter(model, ExportChoices())
    finally:
        model.tokenizer = tokenizer


@pytest.mark.parametrize("without", [(), ("infrastructure_image",)])
def test_a_checkpoint_is_judged_as_its_bundle(
    engine: Engine, model: V2XVLM, without: tuple[str, ...]
) -> None:
    both = {"vehicle_image": picture(0, SQUARE), "infrastructure_image": picture(1, SQUARE)}
    told: dict[str, Any] = {name: each for name, each in both.items() if name not in without}
    told |= {"prompt": PROMPTS[3]}
    served = planner_of_bundle(LocalClient(engine))(told)
    np.testing.assert_allclose(planned(model, told), served, atol=1e-4)
    assert np.abs(planned(model, both | {"prompt": PROMPTS[1]}) - served).max() > 1e-3


def test_a_bundle_is_judged_on_crossings_it_has_not_seen(engine: Engine, tmp_path: Path) -> None:
    dataset, groups = judged_crossings(tmp_path, scenes=3, image_size=IMAGE_SIZE)
    assert [group.title for group in groups] == ["All pairs", "Hidden"]
    assert 0 < len(groups[1].indices) < len(groups[0].indices) == 15

    tables = pair_tables({"tiny": planner_of_bundle(LocalClient(engine))}, dataset, groups)

    rows = {str(row["plan"]): row for row in tables[0].rows}
    assert rows["driven"]["L2 mean"] == 0
    assert rows["driven"]["collision mean"] == 0
    assert [*rows][2:] == ["tiny", "tiny without roadside", "tiny without text"]
    with_it, without = rows["tiny"], rows["tiny without roadside"]
    assert with_it["L2 4.5 s"] != without["L2 4.5 s"]
