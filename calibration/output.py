"""A fit and its verdict as an antenna file and as plain values."""

from typing import Any

import numpy as np

from calibration import channel
from calibration.fit import PARAMETERS, FitResult
from calibration.patterns import Pattern
from calibration.verdict import Judgement
from fieldkit.channel.antenna_file import SHAPES, AntennaFile, Receiver
from fieldkit.channel.spread import table_of


def antenna_file(
    result: FitResult,
    judgement: Judgement,
    radio: str = "",
    pattern: Pattern | None = None,
    family: str = "",
) -> AntennaFile:
    """What a mission reads. `radio`: its settings; `family`: what kind it is."""
    heard = result.readings.distance_m[~result.readings.missed]
    data: dict[str, Any] = {
        "file": result.readings.name,
        "sha256": result.readings.sha256,
        "n_readings": result.n_readings,
        "n_missed": result.n_missed,
        "n_places": result.n_places,
        "min_range_m": float(heard.min()),
        "max_range_m": float(heard.max()),
        "missed": result.missed,
        "threshold_jitter_db": result.threshold.jitter_db,
    }
    for name in ("sigma_time_db", "sigma_place_db"):
        if getattr(result, name) is not None:
            data[name] = getattr(result, name)
    if result.receiver_offsets_db:
        data["receiver_offsets_db"] = {name: value for name, (value, _) in result.receiver_offsets_db.items()}
    spread, _, _ = channel.measured(result)
    return AntennaFile(
        antenna=result.antenna,
        verdict=judgement.state,
        reasons=judgement.reasons,
        intervals_95=result.intervals_95,
        covariance={"names": list(PARAMETERS), "matrix": covariance(result).tolist()},
        data=data,
        radio={name: text for name, text in (("family", family), ("setting", radio)) if text},
        spread=spread,
        receivers=_receivers(result),
        model=_model(pattern),
        pattern={} if pattern is None or _round(pattern) else _table(pattern),
    )


def _receivers(result: FitResult) -> dict[str, Receiver]:
    """Those whose offset is known: the one that all was calibrated with, or the first and those compared with it."""
    names = result.readings.receivers
    if len(names) > 1 and not result.receiver_offsets_db:
        return {}
    return {name: Receiver(result.receiver_offsets_db.get(name, (0.0, 0.0))[0]) for name in names}


def _round(pattern: Pattern | None) -> bool:
    return pattern is None or pattern.family == "circle"


def _model(pattern: Pattern | None) -> str:
    if pattern is None or _round(pattern):
        return "omnidirectional"
    return pattern.family if pattern.family in SHAPES else "tabulated"


def _table(pattern: Pattern) -> dict[str, Any]:
    heading, gain = pattern.table()
    table = {
        "family": pattern.name,
        "heading_deg": heading.tolist(),
        "gain_db": np.round(gain, 3).tolist(),
        "gain_sigma_db": np.round(pattern.gain_sigma(heading), 3).tolist(),
    }
    return {**table, "parameters": pattern.shape} if pattern.shape else table


def covariance(result: FitResult) -> np.ndarray:
    """(3, 3) of power, exponent and sigma itself, clustered by place."""
    pick = [0, 1, len(result.theta) - 1]
    by = np.array([1.0, 1.0, result.antenna.sigma_db])
    return result.covariance[np.ix_(pick, pick)] * np.outer(by, by)


def plain(result: FitResult, judgement: Judgement, pattern: Pattern | None = None) -> dict[str, Any]:
    """For `--json`."""
    more: dict[str, Any] = {} if pattern is None else {"pattern": {**_table(pattern), "bic": pattern.bic}}
    said = {
        **more,
        "verdict": judgement.state,
        "refusals": list(judgement.refusals),
        "warnings": list(judgement.warnings),
        **_values(result),
        "channel": _channel(result),
    }
    # JSON has no word for infinity, which an interval from three places may well reach.
    return {name: _finite(value) for name, value in said.items()}


def _channel(result: FitResult) -> dict[str, Any]:
    """The spread under the names of the antenna file, with the correlation length's interval."""
    spread, found, _ = channel.measured(result)
    interval = {} if found is None else {"correlation_95_m": list(found.correlation_95_m)}
    return {**table_of(spread), **interval}


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return {name: _finite(item) for name, item in value.items()} if isinstance(value, dict) else value


def words(result: FitResult, judgement: Judgement, pattern: Pattern | None = None) -> str:
    """For people: a line for each parameter, then the verdict and why."""
    low_high = {name: f"{low:.2f} to {high:.2f}" for name, (low, high) in result.intervals_95.items()}
    a = result.antenna
    lines = [
        f"path_loss_exponent  {a.path_loss_exponent:8.2f}      95 %: {low_high['path_loss_exponent']}",
        f"power_at_1m_dbm     {a.power_at_1m_dbm:8.2f} dBm  95 %: {low_high['power_at_1m_dbm']}",
        f"sigma_db            {a.sigma_db:8.2f} dB   95 %: {low_high['sigma_db']}",
        f"threshold_dbm       {a.threshold_dbm:8.2f} dBm  95 %: {low_high['threshold_dbm']}",
    ]
    if a.saturation_dbm is not None:
        lines.append(f"saturation_dbm      {a.saturation_dbm:8.2f} dBm")
    if result.sigma_time_db is not None and result.sigma_place_db is not None:
        lines.append(
            f"of sigma: {result.sigma_time_db:.1f} dB at one place over time, "
            f"{result.sigma_place_db:.1f} dB "
            "from place to place (more readings at one place do not reduce it)"
        )
    lines += channel.words(*channel.measured(result))
    if pattern is not None:
        _, gain = pattern.table()
        tried = ", ".join(f"{name} {value:.0f}" for name, value in pattern.bic.items())
        lines.append(
            f"pattern: {pattern.name}, {np.ptp(gain):.1f} dB from its weakest to its best side (BIC: {tried})"
        )
    for name, (value, half) in result.receiver_offsets_db.items():
        lines.append(
            f"receiver {name}: {value:+.1f} dB (± {half:.1f}) against {result.readings.receivers[0]}"
        )
    lines.append(
        f"from {result.n_readings} readings and {result.n_missed} missed packets at {result.n_places} places"
    )
    lines.append(f"verdict: {judgement.state}")
    lines += [f"  refused: {text}" for text in judgement.refusals]
    lines += [f"  warning: {text}" for text in judgement.warnings]
    return "\n".join(lines)


def _values(result: FitResult) -> dict[str, Any]:
    """The result's numbers under the names they have everywhere."""
    return {
        "path_loss_exponent": result.antenna.path_loss_exponent,
        "power_at_1m_dbm": result.antenna.power_at_1m_dbm,
        "sigma_db": result.antenna.sigma_db,
        "threshold_dbm": result.antenna.threshold_dbm,
        "saturation_dbm": result.antenna.saturation_dbm,
        "intervals_95": {name: list(pair) for name, pair in result.intervals_95.items()},
        "sigma_time_db": result.sigma_time_db,
        "sigma_place_db": result.sigma_place_db,
        "threshold_jitter_db": result.threshold.jitter_db,
        "missed": result.missed,
        "converged": result.converged,
        "n_readings": result.n_readings,
        "n_missed": result.n_missed,
        "n_saturated": result.n_saturated,
        "n_places": result.n_places,
        "n_outliers": result.n_outliers,
        "n_lost_near": result.n_lost_near,
        "receiver_offsets_db": {name: value for name, (value, _) in result.receiver_offsets_db.items()},
    }
