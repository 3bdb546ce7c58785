"""What several planners say alike."""

from anchorflow_client.contract import TensorSpec

F32 = "float32"
COMPONENTS = ("x", "y", "heading")  # of a pose
TIMES = TensorSpec("times", F32, ("K",), "", (0.0, 1.0))  # of a flow
