"""The model card through JSON."""

from __future__ import annotations

import json

import pytest

from anchorflow_client import ModelCard


def test_a_card_comes_back_as_it_went(card: ModelCard) -> None:
    assert ModelCard.from_dict(json.loads(json.dumps(card.to_dict()))) == card


def test_a_later_services_keys_are_left_out(card: ModelCard) -> None:
    assert ModelCard.from_dict(card.to_dict() | {"ready": True}) == card


def test_a_missing_key_is_named(card: ModelCard) -> None:
    fields = card.to_dict()
    del fields["sampler"]

    with pytest.raises(KeyError, match="sampler"):
        ModelCard.from_dict(fields)
