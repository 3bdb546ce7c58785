"""Loops that only some requests need, which a service may compile while it already answers.

    defer()           before the first engine, where they are not on disk yet
    compile_later()   once the service answers
    on_demand()       before the only engine of a program that answers a single request

Otherwise the first engine that may need them loads or compiles them.
"""

from __future__ import annotations

import atexit
import logging
import threading
import time

from anchorflow_client.errors import NotReady
from anchorflow_trajectory.warm_up import (
    FORESIGHT,
    GUARD,
    MOVING,
    POSES,
    STILL,
    SUBJECTS,
    USUAL_S,
    compile_loops,
    compiler,
    is_kept,
)

LEAST_S = 5.0
"""Time that is told to be left, if it takes longer than usual."""
SLOWER = 2.0
"""How much longer a niced process takes beside a service."""

logger = logging.getLogger(__name__)


class LaterLoops:
    """Knows whether requests that need the loops of a stage can be answered."""

    def __init__(self, stage: str, field: str, *, after: tuple[str, ...] = (STILL,)) -> None:
        """field: of a request that needs them; after: stages that every request needs."""
        self._stage, self._field, self._after = stage, field, after
        self._is_deferred = self._is_on_demand = False
        self._done = threading.Event()
        self._begin = time.monotonic()

    def defer(self) -> None:
        """Leave the loops for `compile`, unless they are on disk."""
        self._is_deferred = not is_kept(self._stage)

    def on_demand(self) -> None:
        """Leave the loops for the first request that needs them, which compiles them."""
        self._is_on_demand = True

    def load(self) -> None:
        """Make them ready for an engine, and what they build on, unless they are deferred."""
        for stage in self._after:
            compile_loops(stage)
        if not (self._is_deferred or self._is_on_demand):
            compile_loops(self._stage)

    def require(self) -> None:
        """Raise `NotReady` while requests that need them cannot be answered."""
        if self._is_on_demand:
            compile_loops(self._stage)
        if not self._is_deferred or self._done.is_set():
            return
        left = max(SLOWER * USUAL_S[self._stage] - (time.monotonic() - self._begin), LEAST_S)
        raise NotReady(
            f"the loops for {SUBJECTS[self._stage]} are being compiled, once on this machine, for "
            f"about {left:.0f} s more; requests without them are answered",
            self._field,
        )

    def compile(self) -> None:
        """Compile what was deferred, in a niced process."""
        if not self._is_deferred:
            return
        self._begin = time.monotonic()
        try:
            with compiler(self._stage) as process:
                atexit.register(process.terminate)
                process.wait()
                atexit.unregister(process.terminate)
        except OSError as error:
            logger.warning("no process compiles the loops of %s: %s", SUBJECTS[self._stage], error)
        try:
            compile_loops(self._stage)
        finally:
            self._done.set()
        logger.info("requests with %s are answered now", SUBJECTS[self._stage])


MOVING_LOOPS = LaterLoops(MOVING, "obstacles")
POSE_LOOPS = LaterLoops(POSES, "kinematics")
GUARD_LOOPS = LaterLoops(GUARD, "refine.guard", after=())
FORESIGHT_LOOPS = LaterLoops(FORESIGHT, "inputs.others", after=())
LOOPS = (MOVING_LOOPS, POSE_LOOPS, GUARD_LOOPS, FORESIGHT_LOOPS)


def defer() -> None:
    """Leave what is not on disk for `compile_later`."""
    for each in LOOPS:
        each.defer()


def on_demand() -> None:
    """Leave what the first requests do not need."""
    for each in LOOPS:
        each.on_demand()


def starting(began: float) -> str:
    """Return why a service that began to start at a monotonic time is not ready yet."""
    if is_kept(STILL):
        return "the service is starting: it loads its bundles"
    left = USUAL_S[STILL] - (time.monotonic() - began)
    told = f"for about {left:.0f} s more" if left > LEAST_S else "for a little longer than usual"
    return (
        "the service is starting: it compiles its loops for this processor, once on this machine, "
        f"{told}"
    )


def compile_later() -> None:
    """Begin to compile what was deferred, one stage after the other; return at once."""

    def work() -> None:
        for each in LOOPS:
            each.compile()

    threading.Thread(target=work, name="later-loops", daemon=True).start()
