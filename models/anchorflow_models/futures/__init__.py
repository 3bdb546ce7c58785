"""A small network that predicts the other road users, on the raster of a planner."""

from anchorflow_models.futures.config import FuturesConfig as FuturesConfig
from anchorflow_models.futures.network import FuturesNetwork as FuturesNetwork
