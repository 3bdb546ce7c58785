"""The PDM score of NAVSIM v1.1 (Dauner et al., 2024, arXiv:2406.15349), and PDM-Closed."""

from anchorflow_driving.pdm.pdm_closed import PdmClosed as PdmClosed, pdm_closed as pdm_closed
from anchorflow_driving.pdm.score import (
    SUB_SCORES as SUB_SCORES,
    PdmScorer as PdmScorer,
    PdmScores as PdmScores,
)
from anchorflow_driving.pdm.sub_scores import direction_compliance as direction_compliance
