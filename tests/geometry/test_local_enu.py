"""East, north and up against the geometry of the ellipsoid."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.geometry.local_enu import earth_centred, enu, geodetic


def test_known_points_of_the_ellipsoid() -> None:
    a, b = 6378137.0, 6356752.314245179
    found = earth_centred(np.array([[0.0, 0, 0], [0, 90, 10], [90, 0, 0]]))
    np.testing.assert_allclose(found, [[a, 0, 0], [0, a + 10, 0], [0, 0, b]], atol=1e-6)


def test_axes_point_east_north_and_up() -> None:
    origin = np.array([48.0, 11.0, 500.0])
    steps = np.array([[0.0, 1e-4, 0.0], [1e-4, 0.0, 0.0], [0.0, 0.0, 7.0]])
    found = enu(origin + steps, origin)
    # radii of curvature at 48 degrees, 500 m above
    north = np.radians(1e-4) * (6_370_729 + 500)
    east = np.radians(1e-4) * (6_389_957 + 500) * np.cos(np.radians(48))
    np.testing.assert_allclose(found, [[east, 0, 0], [0, north, 0], [0, 0, 7]], atol=2e-3)


@pytest.mark.parametrize("latitude", [-89.9, -33.0, 0.0, 48.0, 90.0])
def test_geodetic_is_the_inverse_of_enu(latitude: float) -> None:
    origin = np.array([latitude, 171.3, 420.0])
    p = np.random.default_rng(1).uniform(-2e4, 2e4, (50, 3))
    np.testing.assert_allclose(enu(geodetic(p, origin), origin), p, atol=1e-5)
