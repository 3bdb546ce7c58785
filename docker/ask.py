"""Plan with a service and check the anchors: python ask.py URL SECONDS_TO_WAIT."""

import os
import sys
import time

import numpy as np

from anchorflow_client import AnchorClient


def main(url: str, wait_s: float) -> None:
    """Exit with an error if no service is ready in time, or its anchors are wrong."""
    with AnchorClient(url, timeout_s=60) as client:
        began = time.monotonic()
        while not client.ready():
            if time.monotonic() - began > wait_s:
                raise SystemExit(f"nothing is ready at {url} after {wait_s:g} s")
            time.sleep(0.2)
        ready_s = time.monotonic() - began
        occupancy = np.zeros((64, 64))
        occupancy[26:38, 30:34] = 1.0
        anchors = client.plan(
            cost_map=occupancy,
            resolution=0.1,
            x_curr=[-2.5, 0.0, 0.0, 0.0, 0.0, 0.0],
            x_goal=[2.5, 0.0, 0.0, 0.0],
            num_samples=64,
            seed=1,
        )
    if anchors.trajectories.shape[0] != 64 or not np.isfinite(anchors.trajectories).all():
        raise SystemExit(f"expected 64 finite anchors, got {anchors.trajectories.shape}")
    if not anchors.safe.any():
        raise SystemExit("no anchor goes round the wall")
    print(
        f"image: ready after {ready_s:.1f} s; as user {os.getuid()}: 64 anchors, "
        f"{int(anchors.safe.sum())} of them safe, in {anchors.timing_ms['total']:.0f} ms"
    )


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
