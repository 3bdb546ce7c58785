"""Simulated driving: road nets by netgenerate, traffic by SUMO, logs of both.

Needs the extra `[driving]`. Right-hand traffic drives on the net as SUMO has it, left-hand traffic
on its mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LogConfig:
    """The settings of simulated logs.

    seconds: recorded
    windows: at most, a third of them turning where there are as many
    left_hand: share of logs in which traffic keeps left
    deviating: share of logs in which vehicles leave their lines, with windows on the way back
    arterial: share of logs on nets of long, fast streets
    speed_limits: whether windows have their lanes' limits, as few recordings do
    """

    seed: int = 0
    seconds: float = 25.0
    windows: int = 48
    left_hand: float = 0.3
    deviating: float = 0.0
    arterial: float = 0.0
    speed_limits: bool = True
