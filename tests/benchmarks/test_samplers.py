"""Names of samplers, and what they cost."""

from __future__ import annotations

import pytest

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.samplers import evaluations, parse_sampler, sampler_name
from anchorflow_client.contract import ModelCard
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle


@pytest.fixture(scope="module")
def card() -> ModelCard:
    return load_bundle(DEFAULT_BUNDLE).card


@pytest.mark.parametrize(
    ("name", "cost"),
    [("rk4:8step", 32), ("rk4:uniform8", 32), ("midpoint:uniform2", 4), ("euler:uniform1", 1)],
)
def test_a_name_and_its_cost(name: str, cost: int, card: ModelCard) -> None:
    sampler = parse_sampler(name, card)

    assert sampler_name(sampler) == name
    assert evaluations(sampler) == cost


def test_the_cards_own(card: ModelCard) -> None:
    assert parse_sampler("card", card) == card.sampler


@pytest.mark.parametrize("text", ["rk4", "rk5:8step", "rk4:9step", "rk4:uniform0", "", "rk4:"])
def test_an_unknown_one_is_refused(text: str, card: ModelCard) -> None:
    with pytest.raises(BenchmarkError, match="sampler"):
        parse_sampler(text, card)
