"""A program: a replica whose engine takes some seconds for an answer.

Arguments: an endpoint, the name, seconds, and "listen" to be a peer there, not a router's client.
"""

import asyncio
import sys
import time

from straight_lines import StraightLines

from anchorflow_client import AnchorBatch
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint


async def serve(settings: ZenohSettings, name: str, seconds: float) -> None:
    """Serve until the process ends."""

    def late(batch: AnchorBatch) -> AnchorBatch:
        time.sleep(seconds)
        return batch

    engine = StraightLines()
    engine.before_answer = late
    session = open_session(settings, wait_s=10)
    with PlanningService({"lines": engine}, default="lines") as service:
        async with ZenohEndpoint(service, session, replica=name):
            sys.stdout.write("up\n")
            sys.stdout.flush()
            await asyncio.Event().wait()


if __name__ == "__main__":
    endpoint, name, seconds, *listens = sys.argv[1:]
    if listens == ["listen"]:
        settings = ZenohSettings(listen=(endpoint,))
    else:
        settings = ZenohSettings(mode="client", connect=(endpoint,))
    asyncio.run(serve(settings, name, float(seconds)))
