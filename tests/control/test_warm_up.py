"""What is compiled before a robot drives is all that it needs."""

from __future__ import annotations

import sys
from typing import Any

from analytic_anchors import batch_of, straight
from driven_robot import square_map
from numba.core.dispatcher import Dispatcher

from anchorflow_control import MppiController, Robot
from anchorflow_control.warm_up import compile_loops


def compiled() -> dict[str, Any]:
    """The types that each of the controller's loops is compiled for."""
    modules = [each for name, each in sys.modules.items() if name.startswith("anchorflow_control")]
    found = {
        each for module in modules for each in vars(module).values() if isinstance(each, Dispatcher)
    }
    return {f"{each.__module__}.{each.__name__}": each.signatures for each in found}


def test_a_robot_that_drives_compiles_nothing_more(robot: Robot) -> None:
    compile_loops()
    before = compiled()
    assert any(before.values())
    anchors = batch_of(straight([0.0, 0.0], [2.0, 0.0], seconds=4.0, steps=16), dt=4.0 / 15)
    moving = {"position": [[1.0, 1.0]], "velocity": [[0.0, -0.3]], "radius": [0.3]}
    controller = MppiController(robot)
    given: dict[str, Any] = {"cost_map": square_map(), "goal": [2.0, 0.0]}
    for name, value in (("anchors", None), ("anchors", anchors), ("obstacles", moving)):
        given[name] = value
        controller.command([0.0] * 5, **given)
    assert compiled() == before
