"""Compile the controller's loops before a robot drives.

    python -m anchorflow_control.warm_up

takes about 20 s, once on a machine; a later process finds them on disk.
"""

from __future__ import annotations

import numpy as np

from anchorflow_client.contract import AnchorBatch, CostMap, ModelId
from anchorflow_control.controller import MppiController
from anchorflow_control.robot import Robot


def compile_loops() -> None:
    """Run the controller alone and along an anchor; a second where its loops are on disk."""
    controller = MppiController(Robot(kind="omni", v_max=1.0, a_max=1.0, radius=0.2))
    line = np.linspace([[0.0, 0.0]], [[1.0, 0.0]], 8, axis=1)
    rates = {"velocities": np.ones_like(line), "accelerations": np.zeros_like(line)}
    anchors = AnchorBatch(
        arrays={"trajectories": line, **rates},
        dt=0.2,
        seed=0,
        model=ModelId("line", "1", ""),
        timing_ms={},
    )
    for along in (None, anchors):
        controller.command(
            np.zeros(5),
            cost_map=CostMap.build(np.zeros((1, 64, 64), np.float32), 0.1),
            goal=[2.0, 0.0],
            anchors=along,
            obstacles={"position": [[0.0, 2.0]], "velocity": [[0.0, 0.1]], "radius": [0.3]},
        )


if __name__ == "__main__":
    compile_loops()
