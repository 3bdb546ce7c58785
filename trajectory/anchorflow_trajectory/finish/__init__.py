"""The finish: optimise sampled anchors, certify them, and repair those that are not safe."""
