"""nuPlan's maps (Caesar et al., 2021): the `map.gpkg` of a city."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.contours import keyholed, union_rings
from anchorflow_driving.errors import LogError
from anchorflow_driving.importers.geopackage import Feature, key_value, layers, read_features
from anchorflow_driving.importers.recording import Lane, RoadMap, is_near

Array = NDArray[np.float64]

DRIVABLE = ("lane_groups_polygons", "lane_group_connectors", "intersections", "carpark_areas")
"""Layers whose union may be driven on, as in NAVSIM 1.1."""
CONNECTORS = "gen_lane_connectors_scaled_width_polygons"


def read_map(path: Path, box: tuple[Array, Array], counts: Counter[str]) -> RoadMap:
    """What lies near a box (its low and high corner, in UTM coordinates) of the map.

    Lane connectors lie in a junction. Painted lines are left out: their kinds have no names there.

    Raises:
        LogError: names the file, the layer, what was expected and what was found.
    """
    system = key_value(path, "meta", "projectedCoordSystem")
    code = re.fullmatch(r"epsg:(32[67](0[1-9]|[1-5]\d|60))", system.lower())
    if code is None:
        raise LogError(
            path, "meta.projectedCoordSystem", expected="a zone of UTM", found=repr(system)
        )
    zone = int(code[1])
    lanes = _lanes(path, zone, box)
    if not lanes:
        raise LogError(path, "lanes_polygons", expected="lanes near the tracks", found="none")
    drivable: list[Array] = []
    for layer in DRIVABLE:
        if layer in layers(path):
            drivable += _polygons(read_features(path, layer, zone=zone), box)
        else:
            counts[f"dropped: layer {layer}, which the map lacks"] += 1
    return RoadMap(
        lanes,
        union_rings(drivable, level=0.5, within=box),
        list(_polygons(read_features(path, "crosswalks", zone=zone), box)),
        lines=[],
    )


def _lanes(path: Path, zone: int, box: tuple[Array, Array]) -> list[Lane]:
    centres: dict[str, Array] = {}
    keys = {"lane": "lane_fid", "connector": "lane_connector_fid"}
    for feature in read_features(path, "baseline_paths", *keys.values(), zone=zone):
        for kind, key in keys.items():
            if feature.values[key] is not None and feature.shapes:
                centres[_name(kind, feature, key)] = feature.shapes[0][0]
    after: dict[str, list[str]] = defaultdict(list)
    ends = ("fid", "exit_lane_fid", "entry_lane_fid")
    for feature in read_features(path, "lane_connectors", *ends, zone=zone):
        # A connector begins where a lane is left and ends where one is entered.
        connector = _name("connector", feature, "fid")
        after[_name("lane", feature, "exit_lane_fid")].append(connector)
        after[connector].append(_name("lane", feature, "entry_lane_fid"))
    lanes = []
    outlines = (("lane", "lanes_polygons", "fid"), ("connector", CONNECTORS, "lane_connector_fid"))
    for kind, layer, key in outlines:
        for feature in read_features(path, layer, key, zone=zone):
            name = _name(kind, feature, key)
            if not feature.shapes or not is_near(feature.shapes[0][0], box):
                continue
            if name not in centres:
                raise LogError(
                    path, "baseline_paths", expected=f"one of the {name} of {layer}", found="none"
                )
            outline = feature.shapes[0][0]
            lanes.append(Lane(name, outline, centres[name], after[name], kind == "connector"))
    return lanes


def _name(kind: str, feature: Feature, key: str) -> str:
    """Lanes and connectors are numbered apart; a column with gaps comes in floats."""
    value = feature.values[key]
    return f"{kind} {int(value) if isinstance(value, float) else value}"


def _polygons(features: Iterator[Feature], box: tuple[Array, Array]) -> Iterator[Array]:
    for feature in features:
        for exterior, *holes in feature.shapes:
            if is_near(exterior, box):
                yield keyholed(exterior, holes)
