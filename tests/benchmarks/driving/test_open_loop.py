"""Drivers on a small log, judged, and the command that does it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from anchorflow_cli.main import main

RUN = ("bench", "drive", "--logs")
