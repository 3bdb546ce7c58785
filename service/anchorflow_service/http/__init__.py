"""HTTP endpoints: `POST /anchors` in JSON and in binary, health, models, metrics and the page.

app          the application: routes and middleware
lifecycle    uvicorn's settings, TLS, and how the service stops
connections  bounds on the number of connections and on their timeouts
exchanges    request ids, and listeners to every exchange
tokens       bearer tokens and what they allow
responses    JSON responses, refusals, client disconnects
anchors, oip_models, routes, page  the routes
"""

from anchorflow_service.http.app import create_app as create_app
