"""The pages under reference/, made from the code at every build: they cannot be outdated."""

from __future__ import annotations

import json

from anchorflow_client import contract
from anchorflow_client.contract.fields import REQUEST
from anchorflow_client.contract.request import MapScenes
from anchorflow_client.contract.ros_grid import RosGrid
from anchorflow_client.planner import Plan, PlannerConfig
from anchorflow_docs.field_sources import (
    dataclass_section,
    held_fields,
    model_section,
    request_fields,
    schema_fields,
)
from anchorflow_docs.tables import ANSWERED, HELD, SENT, endpoints, failures, field_table, refusals
from anchorflow_service.bundle import DEFAULT_BUNDLE, entries, load_bundle, manifest
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.http.schemas import AnchorAnswerBody, ErrorBody
from anchorflow_service.planning import PlanningService
from anchorflow_trajectory.ode.ddim import NoiseLevels

TYPES = (
    contract.AnchorRequest,
    MapScenes,
    contract.CostMap,
    contract.EncodedImage,
    contract.SamplerChoice,
    contract.RefineChoice,
    contract.WarmStart,
    contract.GoalTolerance,
    contract.Obstacles,
    RosGrid,
    contract.AnchorBatch,
    contract.ModelCard,
    contract.ModelId,
    contract.TensorSpec,
    contract.CostMapSpec,
    contract.LimitsSpec,
    contract.TensorsSpec,
    contract.OdeSpec,
    contract.VisionLanguageSpec,
    contract.VocabularySpec,
    contract.TruncatedDiffusionSpec,
    contract.RefineSpec,
    contract.GuardSpec,
    contract.NoFinish,
    contract.TimeSpec,
    contract.AnswerSpec,
    PlannerConfig,
    Plan,
)
ENTRIES = (
    manifest.Manifest,
    manifest.RequestEntry,
    contract.CostMapSpec,
    contract.LimitsSpec,
    contract.TensorsSpec,
    entries.VisionLanguageEntry,
    entries.OdeEntry,
    entries.PriorEntry,
    contract.VocabularySpec,
    entries.TruncatedDiffusionEntry,
    NoiseLevels,
    entries.SplineEntry,
    entries.GuardEntry,
    entries.RasterEntry,
    entries.AgentsEntry,
    contract.NoFinish,
    contract.TimeSpec,
    contract.AnswerSpec,
    manifest.GraphEntry,
    manifest.FileEntry,
)
OPENAPI = "reference/openapi.json"

HTTP = """# Endpoints

{endpoints}

A body of `POST` and its answer are JSON, or binary where the `Content-Type` says so. What a status
means: [errors](errors.md).

The same as a machine reads it: [openapi.json](openapi.json), which a running service shows at
`/openapi.json` too.
"""
REQUEST_PAGE = """# The request

The body of `POST /anchors` in JSON. A planner with a cost map needs `cost_map`, `x_curr` and
`x_goal`; any other needs the `inputs` that its card lists, in one of [these
forms](../wire.md#inputs-in-json). Everything is in SI units and in the frame of the cost map. An
interval that begins with a round bracket leaves its end out. A field that is left out, or null,
takes its default; a field that is not in this table is refused by name. An array of numbers is
nested lists or `{{"dtype", "shape", "base64"}}`: its bytes, little-endian and in row-major order.
`{{"png": …}}` is a greyscale picture in base64 whose values 0 to 255 become 0 to 1; its first row
is the first row of the map, the one with the lowest y.

{fields}

A leading `B` on `cost_map.data`, `x_curr`, `x_goal`, `w_style` or one of the `inputs` makes a batch
of scenes; a field without it is shared by all of them.

## What a model fixes

A request to a planner with a cost map may state `robot_radius`, `v_max`, `a_max` and `horizon_s`,
each within the card's `ranges`; one that has no range there has to be the card's own. Where the
card's `horizon_s` is null each anchor has its own duration. What the card says under `sampler` and
`finish` is a default, which a request's `sampler` and `refine` may replace where their kinds are
`ode` and `spline`. This is the card of the bundle that ships, without its tensors, quality and
training; `GET /v2/models` tells those of any other.

{card}
"""
ANSWER = """# The answer

What `POST /anchors` answers with status 200. Where the request was a batch, a `B` axis leads every
array. `trajectories` are always there; of the other arrays, those that the model's card lists under
`answer`. Extras that the request's `outputs` named stand beside them by their own names.

{fields}
"""
ERRORS = """# Errors

Whatever is refused is answered with the same JSON, on every transport:

{body}

The code has an HTTP status, and a class of its own in the Python client, where all of them are
`RequestError`:

{refusals}

Where there is no such answer at all, the client raises a `TransportError`:

{failures}

Both are `AnchorFlowError`. How to treat them: [clients](../clients.md#when-something-fails); what
messages mean: [troubleshooting](../troubleshooting.md).
"""
PYTHON = """# Python types

`anchorflow_client.contract`, which the service uses too. All of them are frozen; arrays are
read-only. A field that is None is left to the model's card. One that says nothing here means what
it means in [the request](request.md) or [the answer](answer.md). A card's `conditioning` is a
`CostMapSpec`, a `TensorsSpec` or a `VisionLanguageSpec`, its `sampler` an `OdeSpec`, a
`VocabularySpec` or a `TruncatedDiffusionSpec`, its `finish` a `RefineSpec`, a `GuardSpec` or
`NoFinish`; each has a `kind`, and a kind that the client does not know is an `UnknownPart`.

{types}
"""
MANIFEST = """# The bundle's manifest

A bundle is a folder of ONNX graphs and `manifest.json`, which says what they are: the classes below
in JSON. `anchorflow export` writes it and proves that it is true; whoever writes one by hand finds
a whole small bundle in `tests/planners/image_planner.py`, and what the graphs of each sampler take
and give in [Models](../models.md#another-planner). An unknown field, a missing one, a hash that
differs or a graph whose names and shapes are others is refused with the field's path. A
`TensorSpec` is that of the [Python types](python.md#tensorspec).

{entries}
"""


def reference_pages() -> dict[str, str]:
    """Markdown, and one JSON document, by their places below docs/."""
    engine = Engine(load_bundle(DEFAULT_BUNDLE), threads=1)
    service = PlanningService({engine.card.name: engine}, default=engine.card.name)
    openapi = create_app(service).openapi()
    return {
        "reference/http.md": HTTP.format(endpoints=endpoints(openapi)),
        "reference/request.md": REQUEST_PAGE.format(
            fields=field_table(request_fields(REQUEST), SENT),
            card=field_table(held_fields(engine.card), HELD),
        ),
        "reference/answer.md": ANSWER.format(
            fields=field_table(schema_fields(AnchorAnswerBody), ANSWERED)
        ),
        "reference/errors.md": ERRORS.format(
            body=field_table(schema_fields(ErrorBody), ANSWERED),
            refusals=refusals(),
            failures=failures(),
        ),
        "reference/manifest.md": MANIFEST.format(entries="\n\n".join(map(model_section, ENTRIES))),
        "reference/python.md": PYTHON.format(types="\n\n".join(map(dataclass_section, TYPES))),
        OPENAPI: json.dumps(openapi, indent=2),
    }
