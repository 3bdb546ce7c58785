"""The sub-scores of the PDM score, as networks foretell them."""

from __future__ import annotations

from torch import Tensor

SUB_SCORES = ("NC", "DAC", "EP", "TTC", "C")
"""The order of all predictions."""


def pdm_score(sub_scores: Tensor) -> Tensor:
    """[..., 5] in the order of SUB_SCORES -> [...]: NC DAC (5 EP + 5 TTC + 2 C) / 12.

    Of [..., 6] also times the last, DDC, as the extended PDM score of NAVSIM v2 has it.
    """
    nc, dac, ep, ttc, comfort, *direction = sub_scores.unbind(-1)
    score = nc * dac * (5 * ep + 5 * ttc + 2 * comfort) / 12
    return score * direction[0] if direction else score
