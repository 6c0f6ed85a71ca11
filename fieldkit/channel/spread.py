"""What readings of one transmitter have in common beyond the mean law, and how well a calibration knows it.

A reading of source s at place x, in dB (`Antenna` has the mean law alone):

    z = w_s - 10 beta_s log10 d + kappa_s 20 log10 cos(elevation) + l_s . u + S_s(x) + e

w_s, beta_s, kappa_s differ from transmitter to transmitter about the calibration's means; l_s . u is the
transmitter's lobe, u the direction to the receiver as a unit vector; S_s is shadowing, the same for all readings
at one place (Gudmundson, Electronics Letters 27, 1991): normal, with correlation exp(-distance / correlation_m);
e is white. None of it averages out by staying at one place but e.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.errors import ConfigError
from fieldkit.messages import FloatArray

UNKNOWN_POWER_DB = 10.0
"""Standard deviation of a source's power where no transmitters were compared."""
KNOWN_POWER_DB = 0.1
"""The same of sources whose power levels are known."""
ASSUMED_LOBE = 0.5
"""Deviation of each coordinate of a transmitter's lobe, in that of all that does not average out at one place."""
UNMEASURED_RECEIVER_DB = 2.0
"""Standard deviation of a receiver's offset that nobody measured: what radios of one kind differ by."""
HYPER = (
    "sigma_time_db",
    "sigma_place_db",
    "correlation_m",
    "transmitter_db",
    "transmitter_exponent",
    "lobe_db",
)
"""What is only known up to a factor; `log_covariance` has them in this order."""
OWN_FACTOR = (0.2, 0.25, 0.5, 0.0, 0.0, 0.5)
"""How far a transmitter's own values lie from the calibration's, as deviations of their logarithms."""
COEFFICIENTS = 5
"""w, beta, the lobe east and north, kappa: the mean level is linear in them."""


@dataclass(frozen=True, slots=True)
class ChannelSpread:
    """See the module. Deviations in dB."""

    sigma_time_db: float
    """Of e: what more readings at one place average out."""
    sigma_place_db: float
    """Of the shadowing: what they do not."""
    correlation_m: float
    """Distance at which the shadowing's correlation has fallen to 1/e; 0: every reading has its own."""
    transmitter_db: float = UNKNOWN_POWER_DB
    """Of w from transmitter to transmitter."""
    transmitter_exponent: float = 0.3
    """Of beta from transmitter to transmitter."""
    lobe_db: float = 2.0
    """Of each coordinate of the transmitter's lobe."""
    elevation: float = 0.0
    """Mean of kappa: 2 for two vertical dipoles."""
    elevation_sd: float = 1.0
    transmitters: int = 0
    """How many transmitters w was compared between; of fewer than two `transmitter_db` is no measurement."""
    mean_covariance: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.25))
    """(3, 3) of the means of w, beta and kappa."""
    log_covariance: tuple[tuple[float, ...], ...] = field(
        default_factory=lambda: tuple(map(tuple, np.diag([0.09, 0.09, 0.5, 0.09, 0.25, 0.25]).tolist()))
    )
    """(6, 6) of the logarithms of `HYPER`."""
    power_at_1m_dbm: float | None = None
    """Mean of w over the calibration's transmitters; None: the antenna's."""
    path_loss_exponent: float | None = None
    receiver_db: float = UNMEASURED_RECEIVER_DB
    """Of the offsets of receivers that were not measured."""
    assumed: str = ""
    """What of it was not measured, in words; empty where all was."""

    def __post_init__(self) -> None:
        for name in ("sigma_time_db", "transmitter_db"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(
                    f"channel.{name}: expected a positive number of dB, got {getattr(self, name)}"
                )
        for name in (
            "sigma_place_db",
            "correlation_m",
            "transmitter_exponent",
            "lobe_db",
            "elevation_sd",
            "receiver_db",
        ):
            if not getattr(self, name) >= 0.0:
                raise ConfigError(f"channel.{name}: expected no less than 0, got {getattr(self, name)}")


def assumed(antenna: Antenna, data: dict[str, Any] | None = None) -> ChannelSpread:
    """The spread of an antenna file that does not give it: sigma halved between time and place, power unknown."""
    data = data or {}
    half = antenna.sigma_db / np.sqrt(2.0)
    time_db = float(data.get("sigma_time_db") or half)
    place_db = float(data.get("sigma_place_db") or np.sqrt(max(antenna.sigma_db**2 - time_db**2, 0.25)))
    correlation_m = float(np.clip(antenna.nominal_range_m() / 20.0, 1.0, 20.0))
    lobe_db = ASSUMED_LOBE * place_db
    return ChannelSpread(
        max(time_db, 0.3),
        float(np.sqrt(place_db**2 - lobe_db**2)),
        correlation_m,
        lobe_db=lobe_db,
        assumed=f"the antenna file gives no place noise: {time_db:.1f} dB in time, {place_db:.1f} dB from place "
        f"to place over {correlation_m:.0f} m and by direction are assumed{_POWER_ASSUMED}",
    )


_POWER_ASSUMED = f", the source's power is taken for unknown (+-{UNKNOWN_POWER_DB:.0f} dB)"


def known_power(spread: ChannelSpread) -> ChannelSpread:
    """The same for sources whose power levels somebody knows: they differ by no more than was measured, if it was."""
    measured = spread.transmitters >= 2
    return replace(
        spread,
        transmitter_db=spread.transmitter_db if measured else KNOWN_POWER_DB,
        assumed=spread.assumed.replace(_POWER_ASSUMED, ""),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """One way the channel may be: the shadowing's parameters, and the prior of a source's coefficients."""

    time_var: float
    place_var: float
    correlation_m: float
    mean: FloatArray
    """(`COEFFICIENTS`,)"""
    covariance: FloatArray
    """(`COEFFICIENTS`, `COEFFICIENTS`)"""


def draws(
    antenna: Antenna, spread: ChannelSpread, count: int, power_sd_db: float | None = None
) -> list[Draw]:
    """So many equally likely ways the channel may be; the first is the calibration's own. Always the same.

    `power_sd_db` adds to what transmitters of the calibration differ by, for sources that are no such transmitter.
    """
    hyper = np.array([getattr(spread, name) for name in HYPER])
    covariance = np.asarray(spread.log_covariance) + np.diag(np.square(OWN_FACTOR))
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = np.random.default_rng(0).standard_normal((max(1, count), hyper.size))
    # Each with its mirror image: the average of the logarithms stays that of the calibration.
    normal[1::2] = -normal[: normal[1::2].shape[0] * 2 : 2]
    normal[0] = 0.0
    found = []
    for z in normal:
        time_db, place_db, length_m, power_db, exponent, lobe_db = hyper * np.exp(root @ z)
        own = np.array(
            [power_db**2, exponent**2, lobe_db**2, lobe_db**2, spread.elevation_sd**2], dtype=float
        )
        own[0] += (power_sd_db or 0.0) ** 2
        known = np.diag(np.maximum(own, 1e-9))
        where = np.ix_([0, 1, 4], [0, 1, 4])
        known[where] += np.asarray(spread.mean_covariance)
        power, beta = spread.power_at_1m_dbm, spread.path_loss_exponent
        mean = np.array(
            [
                antenna.power_at_1m_dbm if power is None else power,
                antenna.path_loss_exponent if beta is None else beta,
                0.0,
                0.0,
                spread.elevation,
            ]
        )
        found.append(Draw(time_db**2, place_db**2, length_m, mean, known))
    return found


def parse_spread(table: Any, where: str) -> ChannelSpread | None:
    """The `channel` table of an antenna file; None where there is none."""
    if table is None:
        return None
    if not isinstance(table, dict):
        raise ConfigError(f"{where}: channel: expected a table, got {table!r}")
    names = {each.name for each in fields(ChannelSpread)}
    unknown = sorted(set(table) - names)
    if unknown:
        raise ConfigError(
            f"{where}: channel: unknown keys {', '.join(unknown)}; there are {', '.join(names)}"
        )
    values: dict[str, Any] = {}
    for name, value in table.items():
        if name == "assumed":
            values[name] = str(value)
        elif name.endswith("covariance"):
            values[name] = _matrix(
                value, 3 if name.startswith("mean") else len(HYPER), f"{where}: channel.{name}"
            )
        elif isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
            raise ConfigError(f"{where}: channel.{name}: expected a finite number, got {value!r}")
        else:
            values[name] = int(value) if name == "transmitters" else float(value)
    missing = [name for name in ("sigma_time_db", "sigma_place_db", "correlation_m") if name not in values]
    if missing:
        raise ConfigError(f"{where}: channel: expected also {', '.join(missing)}")
    try:
        return ChannelSpread(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def _matrix(value: Any, size: int, where: str) -> tuple[tuple[float, ...], ...]:
    try:
        matrix = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        matrix = np.full((0, 0), np.nan)
    if matrix.shape != (size, size) or not np.all(np.isfinite(matrix)):
        raise ConfigError(f"{where}: expected {size} rows of {size} finite numbers, got {value!r}")
    return tuple(map(tuple, matrix.tolist()))


def table_of(spread: ChannelSpread) -> dict[str, Any]:
    """The `channel` table of an antenna file."""
    table: dict[str, Any] = {}
    for each in fields(spread):
        value = getattr(spread, each.name)
        if isinstance(value, tuple):
            value = [[round(float(entry), 6) for entry in row] for row in value]
        elif isinstance(value, float):
            value = round(value, 4)
        if value is not None and value != "":
            table[each.name] = value
    return table


def with_unknown_power(spread: ChannelSpread, power_db: float = UNKNOWN_POWER_DB) -> ChannelSpread:
    """The same where a source may be any transmitter, not one like those of the calibration."""
    return replace(spread, transmitter_db=float(np.hypot(spread.transmitter_db, power_db)))
