"""The engine: plans anchors for a request, with three parts that a bundle names by kind.

conditioning  reads a request into the inputs of the graphs
samplers      draw anchors with the graphs
finish        turns them into the arrays of the answer
"""

from anchorflow_service.engine.engine import Engine as Engine
