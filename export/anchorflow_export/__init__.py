"""From a checkpoint to a bundle: ONNX graphs, parity proof, manifest."""
