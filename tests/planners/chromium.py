"""Playwright's `expect`; without Playwright the tests that import it skip."""

from __future__ import annotations

from typing import Any

import pytest

expect: Any = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed"
).expect
