"""The model card through JSON."""

from __future__ import annotations

import json
from typing import Any

import pytest

from anchorflow_client import ModelCard


def test_a_card_comes_back_as_it_went(card: ModelCard, free: ModelCard) -> None:
    for each in (card, free):
        assert ModelCard.from_dict(json.loads(json.dumps(each.to_dict()))) == each
    assert free.cost_map.ranges["v_max"] == (0.1, 6.0)
    assert (free.time.dt, free.cost_map.limits.horizon_s) == (None, None)


def test_a_card_without_ranges_lets_nothing_change(card: ModelCard) -> None:
    fields = card.to_dict()
    del fields["conditioning"]["ranges"]

    assert ModelCard.from_dict(fields).cost_map.ranges == {}


def test_a_later_services_keys_are_left_out(card: ModelCard) -> None:
    fields: dict[str, Any] = card.to_dict() | {"ready": True}
    conditioning = fields["conditioning"]
    parts = [conditioning, conditioning["limits"], *(fields[name] for name in ("time", "answer"))]
    for part in (*parts, fields["sampler"], fields["finish"], fields["inputs"][0]):
        part["later"] = 1

    assert ModelCard.from_dict(fields) == card


def test_a_missing_key_is_named(card: ModelCard) -> None:
    fields = card.to_dict()
    del fields["sampler"]

    with pytest.raises(KeyError, match="sampler"):
        ModelCard.from_dict(fields)
