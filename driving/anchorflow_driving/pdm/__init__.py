"""The PDM score of NAVSIM v1.1 (Dauner et al., 2024, arXiv:2406.15349), and PDM-Closed."""

from anchorflow_driving.pdm.pdm_closed import PdmClosed, pdm_closed
from anchorflow_driving.pdm.score import SUB_SCORES, PdmScorer, PdmScores
from anchorflow_driving.pdm.sub_scores import direction_compliance

__all__ = [
    "SUB_SCORES",
    "PdmClosed",
    "PdmScorer",
    "PdmScores",
    "direction_compliance",
    "pdm_closed",
]
