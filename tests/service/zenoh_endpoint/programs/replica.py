"""A replica with a slow engine.

Arguments: an endpoint, the name, seconds, and "listen" to be a peer there, not a router's client.
"""

import asyncio
import sys
import time

import numpy as np

from anchorflow_client import (
    AnchorBatch,
    AnswerSpec,
    CostMapSpec,
    LimitsSpec,
    ModelCard,
    OdeSpec,
    RefineSpec,
    TimeSpec,
)
from anchorflow_client.contract import ResolvedRequest
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint


class Sleeper:
    """Answers with anchors that stand still."""

    card = ModelCard(
        name="sleeper",
        version="1",
        sha256="ab" * 32,
        planner="sleeper",
        inputs=(),
        conditioning=CostMapSpec(3, 64, 64, LimitsSpec(3.0, 2.0, 3.0, 0.25)),
        sampler=OdeSpec("rk4", (0.0, 1.0)),
        finish=RefineSpec(smooth=False, project=False, safety_margin=0.0, guidance=0.0),
        time=TimeSpec(4, 0.0, 1.0),
        answer=AnswerSpec(
            ("x", "y"), ("velocities", "accelerations", "scores", "clearance", "safe")
        ),
    )

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def plan(self, request: ResolvedRequest, /, **_: object) -> AnchorBatch:
        time.sleep(self.seconds)
        paths = np.zeros((request.num_samples, 4, 2), np.float32)
        return AnchorBatch(
            arrays={
                "trajectories": paths,
                "velocities": paths,
                "accelerations": paths,
                "scores": paths[:, 0, 0],
                "clearance": paths[:, 0, 0],
                "safe": np.ones(len(paths), bool),
            },
            dt=1.0,
            seed=request.seed or 0,
            model=self.card.id,
            timing_ms={},
        )


async def serve(settings: ZenohSettings, name: str, seconds: float) -> None:
    """Serve until the process ends."""
    session = open_session(settings, wait_s=10)
    with PlanningService({"sleeper": Sleeper(seconds)}, default="sleeper") as service:
        async with ZenohEndpoint(service, session, replica=name):
            sys.stdout.write("up\n")
            sys.stdout.flush()
            await asyncio.Event().wait()


endpoint, name, seconds, *listens = sys.argv[1:]
if listens == ["listen"]:
    settings = ZenohSettings(listen=(endpoint,))
else:
    settings = ZenohSettings(mode="client", connect=(endpoint,))
asyncio.run(serve(settings, name, float(seconds)))
