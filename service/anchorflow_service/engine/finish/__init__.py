"""The finish: what is done to samples before they are answered, by the kind in the manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from anchorflow_service.engine.finish.none import NoFinish
from anchorflow_service.engine.finish.spline import SplineFinish
from anchorflow_service.engine.parts import Finish

FINISHES: Mapping[str, Callable[..., Finish]] = {"spline": SplineFinish, "none": NoFinish}
