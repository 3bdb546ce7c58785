"""The client over zenoh. Nothing else in this distribution's client imports zenoh.

from anchorflow_client.zenoh_client import ZenohAnchorClient

with ZenohAnchorClient("tcp/127.0.0.1:7447") as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)

client        what a robot holds
async_client  its twin for a program on an event loop
failover      one request: whom it is asked of, one after another, until one answers
attempt       one query of one replica
network       the session, and who is alive on it
replicas      who is alive, how busy, who is asked next
connection    one session, opened in the background
session       settings become a session, or an error that says why not
settings      how to join a network
diagnosis     why a connection did not come about
deadline      the end of a caller's patience
background    work that several callers wait for
"""

from anchorflow_client.zenoh_client.async_client import AsyncZenohAnchorClient
from anchorflow_client.zenoh_client.client import ZenohAnchorClient
from anchorflow_client.zenoh_client.settings import ZenohConfigError, ZenohSettings

__all__ = ["AsyncZenohAnchorClient", "ZenohAnchorClient", "ZenohConfigError", "ZenohSettings"]
