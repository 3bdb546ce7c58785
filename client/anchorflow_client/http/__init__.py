"""The clients over HTTP, with numpy and the standard library alone.

from anchorflow_client.http import AnchorClient

with AnchorClient("http://127.0.0.1:8000") as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)

client                  what a robot holds
async_client            its twin for a program on an event loop
exchange                what is sent, and what the answers mean; knows no socket
whole_number            the number in a header
transport               what carries it: sockets, or whatever a test puts in their place
socket_transport        one connection, kept alive
async_socket_transport  as many connections as there are requests at the same time
answer_parser           an HTTP answer out of bytes as they come
"""

from anchorflow_client.http.async_client import AsyncAnchorClient
from anchorflow_client.http.client import AnchorClient

__all__ = ["AnchorClient", "AsyncAnchorClient"]
