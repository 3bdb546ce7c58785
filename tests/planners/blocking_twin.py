"""An async client or transport with the methods of its blocking twin."""

from __future__ import annotations

import asyncio
from typing import Any


class Blocking:
    """Runs every method of an async object on a loop, until it returns."""

    def __init__(self, twin: Any, loop: asyncio.AbstractEventLoop) -> None:
        self._twin = twin
        self._loop = loop

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._twin, {"close": "aclose"}.get(name, name))

        def call(*arguments: Any, **options: Any) -> Any:
            return self._loop.run_until_complete(method(*arguments, **options))

        return call

    def __enter__(self) -> Any:
        assert self._loop.run_until_complete(self._twin.__aenter__()) is self._twin
        return self

    def __exit__(self, *error: object) -> None:
        self._loop.run_until_complete(self._twin.__aexit__(*error))
