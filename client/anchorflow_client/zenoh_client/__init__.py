"""The clients over zenoh. Only this package of the distribution's client imports zenoh.

from anchorflow_client.zenoh_client import ZenohAnchorClient

with ZenohAnchorClient("tcp/127.0.0.1:7447") as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)

client     the blocking and the async client
failover   sends one request to one replica after another
network    joins the network, and watches its replicas
replicas   which replicas are alive, how busy they are, which one is next
session    opens a session from settings
diagnosis  why a connection failed
"""

from anchorflow_client.zenoh_client.client import (
    AsyncZenohAnchorClient as AsyncZenohAnchorClient,
    ZenohAnchorClient as ZenohAnchorClient,
)
from anchorflow_client.zenoh_client.session import (
    ZenohConfigError as ZenohConfigError,
    ZenohSettings as ZenohSettings,
)
