"""Latitude and longitude as metres north and east of an origin."""

import numpy as np

from diffsea.errors import UserError
from diffsea.trajectory import Samples


# World Geodetic System 1984: semi-major axis (m), flattening and square of the eccentricity.
_SEMI_MAJOR_AXIS = 6378137.0
_FLATTENING = 1 / 298.257223563
_E2 = _FLATTENING * (2 - _FLATTENING)


class PlaceNote(str):
    """A note of a provenance that tells where on the earth a run was."""


def local_position(
    latitude: Samples, longitude: Samples, origin: tuple[float, float]
) -> tuple[Samples, Samples]:
    """Metres north and east of `origin` (latitude, longitude) in its tangent plane.

    Angles in rad, geodetic, WGS84; longitudes may lie either side of the antimeridian. Taylor
    expansion of the tangent plane's axes to second order about the origin, where M is the
    radius of curvature of the meridian and N that of the prime vertical:

        north = M dphi + (dM/dphi) dphi^2 / 2 + N sin(phi) cos(phi) dlambda^2 / 2
        east  = N cos(phi) dlambda - M sin(phi) dphi dlambda

    What is left out is of third order: below 1 cm within 5 km of an origin at less than 75
    degrees of latitude, some decimetres at 20 km.
    """
    phi, zero = origin
    dphi = latitude - phi
    dlambda = np.remainder(longitude - zero + np.pi, 2 * np.pi) - np.pi
    sine, cosine = np.sin(phi), np.cos(phi)
    w2 = 1 - _E2 * sine**2
    prime = _SEMI_MAJOR_AXIS / np.sqrt(w2)
    meridian = _SEMI_MAJOR_AXIS * (1 - _E2) / w2**1.5
    bend = 3 * _E2 * sine * cosine * meridian / w2
    north = meridian * dphi + 0.5 * bend * dphi**2 + 0.5 * prime * sine * cosine * dlambda**2
    east = prime * cosine * dlambda - meridian * sine * dphi * dlambda
    return north, east


def place_fixes(
    latitude: Samples, longitude: Samples, origin: tuple[float, float] | None, where: str
) -> tuple[Samples, Samples, PlaceNote]:
    """North and east (m) of the origin, by default the first valid fix, and a note on it.

    Angles in rad. Raises `UserError`, beginning with `where`, for angles that are none or where
    there is no valid fix.
    """
    fixes = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not fixes.size:
        raise UserError(f"{where}: latitude and longitude have no valid fix")
    for name, series, limit in (("latitude", latitude, 90), ("longitude", longitude, 360)):
        largest = float(np.nanmax(np.abs(series)))
        if largest > np.radians(limit) + 1e-9:
            raise UserError(
                f"{where}: a {name} of {largest:g} rad is none; say which unit it is in, as in "
                f'{name} = {{ column = "...", unit = "deg" }}, with scale = 1e-7 for whole numbers'
            )
    source = "[file] origin"
    if origin is None:
        source = "the first valid fix"
        origin = (float(latitude[fixes[0]]), float(longitude[fixes[0]]))
    north, east = local_position(latitude, longitude, origin)
    place = ", ".join(f"{np.degrees(angle):.9g}" for angle in origin)
    note = PlaceNote(f"x, y are metres north and east of {source}, {place} deg (WGS84)")
    return north, east, note
