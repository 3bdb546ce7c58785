"""Learnt outcomes of a trajectory: sub-scores of the PDM score."""

from __future__ import annotations

from torch import Tensor, nn

from anchorflow_models.goalflow.trajectory_score import LOOKS, RULES, Rules

LEARNT = ("nc", "dac", "ep", "ttc")
"""Sub-scores that are learnt; comfort is a trajectory's own, and its rule says it."""
POSE = 4 + 3  # x, y, direction; speed, acceleration, yaw rate
NC_POWER = 3
"""A collision forfeits all else, and a mean over what may come takes it for half a loss; set on
simulated windows (docs/goalflow-bundle.md)."""


class OutcomeScorer(nn.Module):
    """Logits [B, N, 4] of trajectories, from the features and occupancy at their poses, and the
    rules, which know others' present velocities and no turn.
    """

    def __init__(self, *, steps: int, features: int, context: int, width: int) -> None:
        super().__init__()
        told = steps * (features + POSE + LOOKS) + len(RULES)
        self.of_way = nn.Linear(told, width)
        self.of_scene = nn.Linear(context, width)
        self.rest = nn.Sequential(
            nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU()
        )
        self.out = nn.Linear(width, len(LEARNT))

    def forward(self, told: Tensor, context: Tensor) -> Tensor:
        """told [B, N, F], as `GoalFlow.told` has it; context [B, E]."""
        return self.out(self.rest(self.of_way(told) + self.of_scene(context)[:, None]))


def outcome_scores(logits: Tensor, rules: Rules, by_rules: Tensor) -> Tensor:
    """The PDM score [B, N] of what is expected: learnt logits [B, N, 4] and the rules agree on who
    is hit and what is road, the rule says what is comfortable, and the rest is learnt; times the
    root of the score by the rules [B, N], which believe in no traffic that was learnt.
    """
    nc, dac, ep, ttc = logits.sigmoid().unbind(-1)
    kept = rules.clear * nc**NC_POWER * rules.on_road * dac
    return kept * (5 * ep + 5 * ttc + 2 * rules.comfort) / 12 * by_rules.sqrt()
