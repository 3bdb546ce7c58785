"""The model card through JSON."""

from __future__ import annotations

import json

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
    assert ModelCard.from_dict(card.to_dict() | {"ready": True}) == card


def test_a_missing_key_is_named(card: ModelCard) -> None:
    fields = card.to_dict()
    del fields["sampler"]

    with pytest.raises(KeyError, match="sampler"):
        ModelCard.from_dict(fields)
