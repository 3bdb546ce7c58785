"""What a bundle fixes and what it does unless told, out of its model card."""

from __future__ import annotations

from anchorflow_client.contract import ModelCard
from anchorflow_docs.markdown import code, table

LIMITS = {"robot_radius": "m", "v_max": "m/s", "a_max": "m/s²", "horizon_s": "s"}


def card_table(card: ModelCard) -> str:
    """Markdown of the values that a request meets."""
    rows = [
        [code(name), f"{getattr(card, name):g} {unit}", _adjustable(name, card)]
        for name, unit in LIMITS.items()
    ]
    rows += [
        [code("D"), str(card.D), "fixed"],
        [code("T"), f"{card.T} time steps, {card.dt:.4g} s apart", "fixed"],
        ["channels of the cost map", f"up to {card.map.channels}", "fixed"],
        [code("sampler.method"), card.sampler.method, "a request's choice"],
        [code("sampler.schedule"), _times(card), "a request's choice"],
        [code("refine.smooth"), str(card.refine.smooth).lower(), "a request's choice"],
        [code("refine.project"), str(card.refine.project).lower(), "a request's choice"],
        [code("refine.safety_margin"), f"{card.refine.safety_margin:g} m", "a request's choice"],
        [code("refine.guidance"), f"{card.refine.guidance:g}", "a request's choice"],
        [code("refine.barrier"), str(card.refine.barrier).lower(), "a request's choice"],
        [
            code("refine.certified_margin"),
            f"{card.refine.certified_margin:g} m",
            "a request's choice",
        ],
    ]
    return table([card.name, "value", ""], rows)


def _adjustable(name: str, card: ModelCard) -> str:
    return "adjustable" if name in card.adjustable else "fixed"


def _times(card: ModelCard) -> str:
    return ", ".join(f"{time:g}" for time in card.sampler.schedule)
