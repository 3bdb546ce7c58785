"""The clients over HTTP, with numpy and the standard library alone.

from anchorflow_client.http import AnchorClient

with AnchorClient("http://127.0.0.1:8000") as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)

client           the blocking and the async client
exchange         requests to send and answers to read, without any I/O
answer_parser    parses an HTTP answer from bytes as they arrive
transport        the transport interfaces, and one kept-alive socket
async_transport  one connection for each concurrent request on an event loop
"""

from anchorflow_client.http.client import (
    AnchorClient as AnchorClient,
    AsyncAnchorClient as AsyncAnchorClient,
)
