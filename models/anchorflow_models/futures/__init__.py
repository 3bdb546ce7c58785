"""Where the others will be: a small network beside a planner, on the same raster."""

from anchorflow_models.futures.config import FuturesConfig as FuturesConfig
from anchorflow_models.futures.network import FuturesNetwork as FuturesNetwork
