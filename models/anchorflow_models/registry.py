"""The planners, by their name in configurations, checkpoints and bundles.

A new planner is a folder with a configuration and a network, and a line here; one more in
`anchorflow_training.planners` to train it, one in `anchorflow_export.planners` to export it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torch import nn

from anchorflow_models.diffusiondrive import DiffusionDriveConfig, create_diffusiondrive
from anchorflow_models.flowmp import L2Config, create_l2_safety_cfm
from anchorflow_models.futures import FuturesConfig, FuturesNetwork
from anchorflow_models.goalflow import GoalFlowConfig, create_goalflow
from anchorflow_models.v2x_vlm import V2XConfig, create_v2x_vlm
from anchorflow_models.wote import WoteConfig, create_wote


@dataclass(frozen=True)
class Planner:
    """A kind of planner.

    config: dataclass that fixes its network's shape and units
    create: makes a network of a configuration, with random weights
    """

    name: str
    config: type
    create: Callable[[Any], nn.Module]


PLANNERS: Mapping[str, Planner] = {
    planner.name: planner
    for planner in (
        Planner("flowmp", L2Config, create_l2_safety_cfm),
        Planner("goalflow", GoalFlowConfig, create_goalflow),
        Planner("wote", WoteConfig, create_wote),
        Planner("diffusiondrive", DiffusionDriveConfig, create_diffusiondrive),
        Planner("v2x_vlm", V2XConfig, create_v2x_vlm),
        Planner("futures", FuturesConfig, FuturesNetwork),
    )
}

UNNAMED = "flowmp"
"""The planner of checkpoints and configuration files that name none."""


def planner_named(name: str) -> Planner:
    """Return the planner of a name.

    Raises:
        ValueError: there is none; the message names those that there are.
    """
    if name not in PLANNERS:
        raise ValueError(f"planner: expected one of {', '.join(PLANNERS)}, got {name!r}")
    return PLANNERS[name]
