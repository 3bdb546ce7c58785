"""GeoPackages (OGC 12-128r19): SQLite files of lines and polygons, here in UTM coordinates."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anchorflow_driving.errors import LogError
from anchorflow_driving.geometry import Array

Rings = list[Array]
"""A line, or a polygon's exterior and its holes; each [V, 2]."""

WGS84 = 4326
_ENVELOPE = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}  # bytes, by the code in the header's flags
_LINE, _POLYGON, _MULTI = 2, 3, (4, 5, 6, 7)
_BOUND = 1_000_000  # parts of one geometry


@dataclass(frozen=True)
class Feature:
    shapes: list[Rings]
    values: dict[str, int | float | str | None]


def read_features(path: Path, layer: str, *columns: str, zone: int) -> Iterator[Feature]:
    """The features of a layer, with other columns of it.

    zone: EPSG code of the UTM zone that coordinates are wanted in

    Raises `LogError` if the file cannot be read, a layer or column is missing, or a geometry is
    none.
    """
    named = _rows(path, "gpkg_geometry_columns", "table_name", "column_name")
    geometry = dict(named).get(layer)
    if geometry is None:
        raise LogError(path, layer, expected="the layer", found="none")
    for blob, *values in _rows(path, layer, str(geometry), *columns):
        try:
            shapes = _shapes(blob, zone)
        except (ValueError, TypeError, struct.error) as error:
            raise LogError(
                path, f"{layer}.{geometry}", expected="lines or polygons", found=str(error)
            ) from error
        yield Feature(shapes, dict(zip(columns, values, strict=True)))


def layers(path: Path) -> set[str]:
    """Names of the layers with geometries."""
    return {name for (name,) in _rows(path, "gpkg_geometry_columns", "table_name")}


def key_value(path: Path, table: str, key: str) -> str:
    """Return the value of a key in a table of keys and values."""
    values = dict(_rows(path, table, "key", "value"))
    if key not in values:
        raise LogError(path, f"{table}.key", expected=key, found=", ".join(map(str, values)))
    return str(values[key])


def utm(longitude_latitude: Array, zone: int) -> Array:
    """Easting and northing [..., 2], m, of degrees [..., 2] on WGS 84.

    Krüger's series to the third power of the flattening: a millimetre within the zone
    (Karney, Transverse Mercator with an accuracy of a few nanometers, 2011, equations 7 to 11).

    zone: EPSG code, 32601 to 32660 north and 32701 to 32760 south
    """
    a, f = 6378137.0, 1 / 298.257223563
    n = f / (2 - f)
    radius = 0.9996 * a / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    series = (
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16,
        13 * n**2 / 48 - 3 * n**3 / 5,
        61 * n**3 / 240,
    )
    longitude, latitude = np.moveaxis(np.deg2rad(longitude_latitude), -1, 0)
    east = longitude - np.deg2rad(6 * (zone % 100) - 183)
    e = 2 * np.sqrt(n) / (1 + n)
    sine = np.sin(latitude)
    t = np.sinh(np.arctanh(sine) - e * np.arctanh(e * sine))
    xi, eta = np.arctan2(t, np.cos(east)), np.arctanh(np.sin(east) / np.hypot(1.0, t))
    x, y = eta.copy(), xi.copy()
    for j, alpha in enumerate(series, start=1):
        x += alpha * np.cos(2 * j * xi) * np.sinh(2 * j * eta)
        y += alpha * np.sin(2 * j * xi) * np.cosh(2 * j * eta)
    south = 10_000_000.0 if zone // 100 == 327 else 0.0
    return np.stack([500_000.0 + radius * x, south + radius * y], -1)


def _rows(path: Path, table: str, *columns: str) -> Iterator[tuple]:
    names = ", ".join(f'"{column}"' for column in columns)
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as file:
            known = [row[1] for row in file.execute(f'PRAGMA table_info("{table}")')]
            for column in columns:
                if column not in known:  # in double quotes, SQLite would take it as a text
                    raise LogError(path, f"{table}.{column}", expected="the column", found="none")
            yield from file.execute(f'SELECT {names} FROM "{table}"')
    except sqlite3.Error as error:
        raise LogError(path, "file", expected="a GeoPackage", found=str(error)) from error


def _shapes(blob: bytes, zone: int) -> list[Rings]:
    if not isinstance(blob, bytes) or blob[:2] != b"GP":
        raise ValueError("no geometry")
    flags = blob[3]
    (system,) = struct.unpack_from("<i" if flags & 1 else ">i", blob, 4)
    if system not in (WGS84, zone):
        raise ValueError(f"coordinates of EPSG:{system}")
    begin = 8 + _ENVELOPE[(flags >> 1 & 7) % 5]
    shapes, _ = _parsed(blob, begin)
    if system == WGS84:
        shapes = [[utm(ring, zone) for ring in rings] for rings in shapes]
    return shapes


def _parsed(blob: bytes, at: int) -> tuple[list[Rings], int]:
    """Shapes of well-known binary from a byte on, and the byte after it."""
    order = "<" if blob[at] else ">"
    code, count = struct.unpack_from(f"{order}II", blob, at + 1)
    kind, axes = code % 1000, {0: 2, 1: 3, 2: 3, 3: 4}.get(code // 1000)
    at += 9
    if axes is None or count > _BOUND:
        raise ValueError(f"a geometry of the type {code} with {count} parts")
    if kind in _MULTI:
        shapes: list[Rings] = []
        for _ in range(count):
            inner, at = _parsed(blob, at)
            shapes += inner
        return shapes, at
    if kind not in (_LINE, _POLYGON):
        raise ValueError(f"a geometry of the type {code}")
    rings = []
    for _ in range(1 if kind == _LINE else count):
        points = count
        if kind == _POLYGON:
            (points,) = struct.unpack_from(f"{order}I", blob, at)
            at += 4
        flat = np.frombuffer(blob, f"{order}f8", points * axes, at)
        at += 8 * points * axes
        ring = flat.reshape(points, axes)[:, :2].astype(np.float64)
        if points < 2 or not np.isfinite(ring).all():
            raise ValueError(f"{points} points" if points < 2 else "NaN or infinity")
        rings.append(ring)
    return [rings] if rings else [], at
