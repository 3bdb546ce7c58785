"""Programs that measure: the quality of anchors, the latency of the engine, a server under load."""
