"""The PDM score of NAVSIM v1.1 (Dauner et al., 2024, arXiv:2406.15349), and PDM-Closed."""

from anchorflow_driving.pdm.closed import PdmClosed, pdm_closed
from anchorflow_driving.pdm.score import PdmScorer, PdmScores

__all__ = ["PdmClosed", "PdmScorer", "PdmScores", "pdm_closed"]
