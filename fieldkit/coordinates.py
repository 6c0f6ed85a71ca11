"""A place in the words that people and maps use: latitude and longitude, UTM, MGRS. Through the packages utm and mgrs.

Both are imported when they are first needed.
"""

from dataclasses import dataclass

from fieldkit.errors import ConfigError

MGRS_DIGITS = 5
"""A metre."""


@dataclass(frozen=True, slots=True)
class Coordinates:
    """One place, as text to be read out or copied."""

    lat_lon: str
    """Degrees to a tenth of a metre or so."""
    utm: str
    """Zone, easting and northing to the metre; empty near the poles, where there is no UTM."""
    mgrs: str


def coordinates(lat_deg: float, lon_deg: float) -> Coordinates:
    """A place in the usual words. Raises `ConfigError` for what is no place on Earth."""
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        raise ConfigError(f"latitude {lat_deg}, longitude {lon_deg}: no place on Earth")
    import mgrs

    grid: str = mgrs.MGRS().toMGRS(lat_deg, lon_deg, MGRSPrecision=MGRS_DIGITS)
    return Coordinates(f"{lat_deg:.6f}, {lon_deg:.6f}", _utm(lat_deg, lon_deg), grid)


def _utm(lat_deg: float, lon_deg: float) -> str:
    import utm

    try:
        east_m, north_m, zone, letter = utm.from_latlon(lat_deg, lon_deg)
    except utm.OutOfRangeError:
        return ""
    return f"{zone}{letter} {east_m:.0f} {north_m:.0f}"


def from_utm(east_m: float, north_m: float, zone: int, *, northern: bool) -> tuple[float, float]:
    """Latitude and longitude in degrees. Coordinates a little outside the zone are taken: maps overlap.

    Raises `ConfigError` for what is no UTM.
    """
    import utm

    try:
        lat_deg, lon_deg = utm.to_latlon(east_m, north_m, zone, northern=northern, strict=False)
    except utm.OutOfRangeError as error:
        raise ConfigError(f"UTM zone {zone}, {east_m:g}, {north_m:g}: {error}") from error
    return float(lat_deg), float(lon_deg)
