"""Trajectory mathematics in numpy and numba: splines, clearance, routes, cost, descent.

The service refines anchors with it and the training's expert is built on it, so both mean the same
by "clearance", "cost" and "within the limits".
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]
