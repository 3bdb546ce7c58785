"""HTTP endpoints: `POST /anchors` in JSON and in binary, health, models, metrics and the page.

app          the application: routes and middleware
lifecycle    uvicorn's settings, TLS, and how the service stops
connections  how many connections there may be, and how long they may take
exchanges    request ids, and who is told of every exchange
tokens       bearer tokens and what they allow
responses    JSON responses, refusals, client disconnects
anchors, oip_models, routes, page  the routes
"""

from anchorflow_service.http.app import create_app

__all__ = ["create_app"]
