"""The engine: a request in, anchors out, in three parts that a bundle names by kind.

conditioning  what a request says, as the inputs of the graphs
samplers      anchors drawn from the graphs
finish        what is done to the anchors before they are answered
"""

from anchorflow_service.engine.engine import Engine

__all__ = ["Engine"]
