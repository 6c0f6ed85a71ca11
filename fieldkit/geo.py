"""Latitude and longitude to the field's local frame and back. Only the edges of the system need this."""

from dataclasses import dataclass
from functools import lru_cache

import pymap3d


@dataclass(frozen=True, slots=True)
class FieldFrame:
    """The field's local frame: metres east and north of its south-west corner, tangent to WGS-84 there."""

    origin_lat_deg: float
    origin_lon_deg: float
    origin_alt_m: float = 0.0

    def to_local(
        self, lat_deg: float, lon_deg: float, alt_m: float | None = None
    ) -> tuple[float, float, float]:
        """East, north, up in metres. Altitude defaults to the origin's."""
        alt = self.origin_alt_m if alt_m is None else alt_m
        east, north, up = pymap3d.geodetic2enu(
            lat_deg, lon_deg, alt, self.origin_lat_deg, self.origin_lon_deg, self.origin_alt_m
        )
        return float(east), float(north), float(up)

    def to_geodetic(self, east_m: float, north_m: float, up_m: float = 0.0) -> tuple[float, float, float]:
        """Latitude, longitude (deg) and altitude (m)."""
        return _to_geodetic(self, round(east_m, 6), round(north_m, 6), round(up_m, 6))


@lru_cache(maxsize=4096)
def _to_geodetic(frame: FieldFrame, east_m: float, north_m: float, up_m: float) -> tuple[float, float, float]:
    lat, lon, alt = pymap3d.enu2geodetic(
        east_m, north_m, up_m, frame.origin_lat_deg, frame.origin_lon_deg, frame.origin_alt_m
    )
    return float(lat), float(lon), float(alt)
