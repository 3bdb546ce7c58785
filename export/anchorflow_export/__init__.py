"""Export a checkpoint to a bundle: trace ONNX graphs, prove parity, write the manifest."""
