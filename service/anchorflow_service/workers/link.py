"""What a supervisor and a worker say to each other, over a pipe between them.

A pipe and not signals: who stops a service may well send its signal to every process of it, and a
second one would end the notice. And a pipe breaks where the supervisor dies, so that no worker is
left behind.
"""

from __future__ import annotations

SERVES = b"serves "
"""By a worker: requests are taken. A JSON array follows: the models' names and versions in one
text, then their names, the default first."""
FAILED = b"failed "
"""By a worker: it cannot start; one line follows."""
LEAVE = b"leave"
"""To a worker: go as on SIGTERM."""
NOW = b"now"
"""To a worker: take no more notice, close the port now."""
