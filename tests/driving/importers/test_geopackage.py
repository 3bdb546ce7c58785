"""UTM coordinates against published ones."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_driving.importers.geopackage import utm

# Meridian arc of WGS 84 from the equator to 45 degrees, m.
ARC_45 = 4984944.378


@pytest.mark.parametrize(
    ("longitude", "latitude", "zone", "easting", "northing"),
    [
        (3.0, 0.0, 32631, 500_000.0, 0.0),
        (6.0, 0.0, 32631, 833_978.557, 0.0),  # where zones meet at the equator
        (0.0, 0.0, 32631, 166_021.443, 0.0),
        (3.0, 45.0, 32631, 500_000.0, 0.9996 * ARC_45),
        (3.0, -45.0, 32731, 500_000.0, 1e7 - 0.9996 * ARC_45),
    ],
)
def test_utm_is_what_is_published(
    longitude: float, latitude: float, zone: int, easting: float, northing: float
) -> None:
    found = utm(np.array([longitude, latitude]), zone)

    np.testing.assert_allclose(found, [easting, northing], rtol=0, atol=1e-3)


def test_utm_is_conformal() -> None:
    """Steps to the north and to the east are as long and at right angles."""
    here, step = np.array([-115.0, 36.1]), 1e-5
    origin, east, north = utm(here + np.array([[0.0, 0.0], [step, 0.0], [0.0, step]]), 32611)

    phi = np.deg2rad(here[1])
    eccentricity2 = 2 / 298.257223563 - 1 / 298.257223563**2
    # Metres of a step on the ellipsoid: radii of curvature of the parallel and of the meridian.
    across = 6378137.0 / np.sqrt(1 - eccentricity2 * np.sin(phi) ** 2)
    along = across * (1 - eccentricity2) / (1 - eccentricity2 * np.sin(phi) ** 2)
    east, north = east - origin, north - origin
    assert east @ north == pytest.approx(0.0, abs=1e-6)
    scale_east = np.hypot(*east) / (np.deg2rad(step) * across * np.cos(phi))
    scale_north = np.hypot(*north) / (np.deg2rad(step) * along)
    assert scale_east == pytest.approx(scale_north, rel=1e-6)
    assert 0.9996 < scale_east < 1.001
