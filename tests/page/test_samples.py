"""Planners without a map open with a drive of this project, never with zeros or black pictures."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract.inputs import read_inputs
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.http.page import FOLDER

SAMPLES = [json.loads(path.read_text()) for path in (FOLDER / "samples").glob("*.json")]
PLANNERS = ("goalflow", "wote", "diffusiondrive", "v2x")


def fits(drive: dict[str, Any], card: Any) -> bool:
    held = {each["name"]: (each["dtype"], each["shape"]) for each in drive["inputs"]}

    def fitting(spec: Any) -> bool:
        dtype, shape = held.get(spec.name, ("", []))
        sizes = zip(spec.shape[1:], shape, strict=True) if shape else ()
        return dtype == spec.dtype and all(w in (s, str(w)) for w, s in sizes)

    return all(map(fitting, card.inputs))


@pytest.mark.parametrize("name", PLANNERS)
def test_a_sample_shows_every_shipped_planner_something(name: str) -> None:
    card = load_bundle(DEFAULT_BUNDLE.parent / name).card
    (drive,) = (each for each in SAMPLES if fits(each, card))

    assert len(drive["frames"]) >= 5
    for frame in drive["frames"]:
        for spec in card.inputs:
            value = frame["inputs"][spec.name]
            if spec.dtype == "text":
                assert "m/s" in value
                continue
            if isinstance(value, dict):
                data = zlib.decompress(base64.b64decode(value["zlib"]))
                value = np.frombuffer(data, value["dtype"]).reshape(value["shape"])
            assert np.ptp(value) > 0, spec.name


def test_a_planner_opens_with_its_sample_and_a_phone_shows_it(
    open_page: Callable[..., Any], served_all: Any
) -> None:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    phone: dict[str, Any] = {"has_touch": True, "is_mobile": True}
    visit = open_page(served_all.url, viewport={"width": 360, "height": 780}, **phone)
    visit.wait_for_anchors()
    for name, text in (("v2x", "1 anchor, in gold."), ("goalflow", "64 anchors, the best")):
        asked = visit.answer(
            lambda name=name: visit.locate("#bundle").select_option(name),
            lambda asked, name=name: asked["model"] == name,
        )
        assert asked.status == 200
        values = [np.asarray(each) for each in read_inputs(asked.asked["inputs"]).values()]
        assert all(value.dtype.kind in "OUS" or np.ptp(value) > 0 for value in values)
        sync_api.expect(visit.locate("#summary")).to_contain_text(text)
        sync_api.expect(visit.locate("#drive-sample")).to_be_visible()
        assert visit.page.evaluate("document.documentElement.scrollWidth") == 360
        visit.keep(f"sample-{name}.png")
    assert visit.errors == []
