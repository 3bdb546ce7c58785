"""What a bundle fixes and what it does unless told, out of its model card."""

from __future__ import annotations

import json
from dataclasses import asdict

from anchorflow_client.contract import ModelCard, RefineSpec
from anchorflow_docs.markdown import code, table

LIMITS = {"robot_radius": "m", "v_max": "m/s", "a_max": "m/s²", "horizon_s": "s"}


def card_table(card: ModelCard) -> str:
    """Markdown of the values that a request meets."""
    rows = [
        [code(name), f"{getattr(card.cost_map.limits, name):g} {unit}", _adjustable(name, card)]
        for name, unit in LIMITS.items()
    ]
    rows += [
        [code("D"), str(card.D), "fixed"],
        [code("T"), f"{card.T} time steps, {card.time.dt:.4g} s apart", "fixed"],
        ["channels of the cost map", f"up to {card.cost_map.channels}", "fixed"],
        [code("sampler.method"), card.ode.method, "a request's choice"],
        [code("sampler.schedule"), _times(card), "a request's choice"],
    ]
    if isinstance(card.finish, RefineSpec):
        told = asdict(card.finish).items()
        rows += [
            [code(f"refine.{name}"), json.dumps(value), "a request's choice"]
            for name, value in told
            if name != "kind"
        ]
    return table([card.name, "value", ""], rows)


def _adjustable(name: str, card: ModelCard) -> str:
    return "adjustable" if name in card.cost_map.adjustable else "fixed"


def _times(card: ModelCard) -> str:
    return ", ".join(f"{time:g}" for time in card.ode.schedule)
