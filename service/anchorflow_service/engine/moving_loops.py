"""The loops for moving obstacles, which a service may compile while it already answers.

    MOVING_LOOPS.defer()       before the first engine, where they are not on disk yet
    MOVING_LOOPS.compile()     once the service answers

Otherwise the first engine with a spline finish loads or compiles them.
"""

from __future__ import annotations

import atexit
import logging
import threading
import time

from anchorflow_client.errors import NotReady
from anchorflow_trajectory.warm_up import MOVING, STILL, USUAL_S, compile_loops, compiler, is_kept

LEAST_S = 5.0
"""Time that is told to be left, if it takes longer than usual."""
SLOWER = 2.0
"""How much longer a niced process takes beside a service."""

logger = logging.getLogger(__name__)


class MovingLoops:
    """Knows whether requests with obstacles can be answered."""

    def __init__(self) -> None:
        self._is_deferred = False
        self._done = threading.Event()
        self._begin = time.monotonic()

    def defer(self) -> None:
        """Leave the loops for `compile`, unless they are on disk."""
        self._is_deferred = not is_kept(MOVING)

    def load(self) -> None:
        """Make ready what an engine needs: everything, or what it needs where nothing moves."""
        compile_loops(STILL)
        if not self._is_deferred:
            compile_loops(MOVING)

    def compile(self) -> None:
        """Begin to compile what was deferred, in a niced process; return at once."""
        if self._is_deferred:
            self._begin = time.monotonic()
            threading.Thread(target=self._compile, name="moving-loops", daemon=True).start()

    def require(self) -> None:
        """Raise `NotReady` while requests with obstacles cannot be answered."""
        if not self._is_deferred or self._done.is_set():
            return
        left = max(SLOWER * USUAL_S[MOVING] - (time.monotonic() - self._begin), LEAST_S)
        raise NotReady(
            "the loops for moving obstacles are being compiled, once on this machine, for about "
            f"{left:.0f} s more; requests without obstacles are answered",
            "obstacles",
        )

    def _compile(self) -> None:
        try:
            with compiler(MOVING) as process:
                atexit.register(process.terminate)
                process.wait()
                atexit.unregister(process.terminate)
        except OSError as error:
            logger.warning("no process compiles the loops for moving obstacles: %s", error)
        try:
            compile_loops(MOVING)
        finally:
            self._done.set()
        logger.info("requests with moving obstacles are answered now")


MOVING_LOOPS = MovingLoops()
