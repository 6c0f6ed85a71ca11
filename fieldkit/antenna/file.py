"""antenna.toml: what calibration hands to a mission. A file, not an import."""

import tomllib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import tomlkit

from fieldkit.antenna.model import Antenna
from fieldkit.errors import ConfigError

SCHEMA = 1
Verdict = Literal["accepted", "accepted with warnings", "refused"]
_REQUIRED = ("path_loss_exponent", "power_at_1m_dbm", "sigma_db", "threshold_dbm")


@dataclass(frozen=True, slots=True)
class AntennaFile:
    """An antenna with where it came from and how far to trust it."""

    antenna: Antenna
    verdict: Verdict = "accepted"
    reasons: tuple[str, ...] = ()
    """Why there are warnings or a refusal, each with what to do."""
    intervals_95: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Parameter name to its 95 % interval, clustered by place."""
    covariance: dict[str, Any] = field(default_factory=dict)
    """{"names": [...], "matrix": [[...]]} of the estimated parameters."""
    data: dict[str, Any] = field(default_factory=dict)
    """file, sha256, n_readings, n_missed, n_places, min_range_m, max_range_m."""
    radio: dict[str, Any] = field(default_factory=dict)
    """family, setting: free text about the radios the readings came from."""
    model: str = "omnidirectional"
    """"tabulated" where `pattern` holds an antenna's gain by heading."""
    pattern: dict[str, Any] = field(default_factory=dict)
    """family, heading_deg (clockwise from the antenna's front), gain_db; empty: the same all round."""


def read_antenna(path: Path, *, allow_refused: bool = False, allow_pattern: bool = False) -> AntennaFile:
    """Read an antenna file. Raises `ConfigError` naming file, key, what was expected and what was there.

    A file whose verdict is `refused` is an error unless `allow_refused`. So is one with a radiation pattern
    unless `allow_pattern`: who reads only `antenna` would take a directional antenna for one that is not.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such antenna file; make one with 'fieldkit calibrate fit'") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
    parsed = parse_antenna(raw, str(path))
    if parsed.pattern and not allow_pattern:
        raise ConfigError(
            f"{path}: model: expected 'omnidirectional', got {parsed.model!r}: this antenna's "
            "gain depends on heading"
        )
    if parsed.verdict == "refused" and not allow_refused:
        reasons = "; ".join(parsed.reasons) or "no reason recorded"
        raise ConfigError(
            f"{path}: this calibration was refused ({reasons}); collect what is missing and fit again"
        )
    return parsed


def parse_antenna(raw: dict[str, Any], where: str) -> AntennaFile:
    """Check a parsed antenna file. `where` names it in errors."""
    schema = raw.get("schema")
    if not isinstance(schema, int):
        raise ConfigError(f"{where}: schema: expected the integer {SCHEMA}, got {schema!r}")
    if schema > SCHEMA:
        raise ConfigError(
            f"{where}: schema: {schema} is newer than this fieldkit knows ({SCHEMA}); update fieldkit"
        )
    model, pattern = raw.get("model", "omnidirectional"), raw.get("pattern", {})
    if model not in ("omnidirectional", "tabulated"):
        raise ConfigError(f"{where}: model: expected 'omnidirectional' or 'tabulated', got {model!r}")
    if model == "tabulated":
        _check_pattern(pattern, where)
    parameters = raw.get("parameters")
    if not isinstance(parameters, dict):
        raise ConfigError(f"{where}: parameters: expected a table, got {parameters!r}")
    values: dict[str, float | None] = {"saturation_dbm": None}
    for name in (*_REQUIRED, "saturation_dbm"):
        value = parameters.get(name)
        if value is None and name == "saturation_dbm":
            continue
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or value != value
            or abs(value) > 1e6
        ):
            raise ConfigError(f"{where}: parameters.{name}: expected a finite number, got {value!r}")
        values[name] = float(value)
    for name in ("path_loss_exponent", "sigma_db"):
        if values[name] <= 0:  # type: ignore[operator]
            raise ConfigError(f"{where}: parameters.{name}: expected a positive number, got {values[name]}")
    verdict = raw.get("verdict", {})
    state = verdict.get("state", "accepted")
    if state not in ("accepted", "accepted with warnings", "refused"):
        raise ConfigError(
            f"{where}: verdict.state: expected accepted, accepted with warnings or refused, got {state!r}"
        )
    return AntennaFile(
        antenna=Antenna(**values),  # type: ignore[arg-type]
        verdict=state,
        reasons=tuple(verdict.get("reasons", ())),
        intervals_95={
            name: (float(low), float(high)) for name, (low, high) in raw.get("intervals_95", {}).items()
        },
        covariance=dict(raw.get("covariance", {})),
        data=dict(raw.get("data", {})),
        radio=dict(raw.get("radio", {})),
        model=model,
        pattern=dict(pattern) if model == "tabulated" else {},
    )


def _check_pattern(pattern: Any, where: str) -> None:
    """Two equally long lists of numbers."""
    lists = [pattern.get(name) if isinstance(pattern, dict) else None for name in ("heading_deg", "gain_db")]
    columns = [
        each for each in lists if isinstance(each, list) and all(isinstance(x, int | float) for x in each)
    ]
    if len(columns) != 2 or len(columns[0]) != len(columns[1]) or len(columns[0]) < 4:
        raise ConfigError(
            f"{where}: pattern: expected equally long lists heading_deg and gain_db of 4 numbers or more, "
            f"got {pattern!r}"
        )


def dump_antenna(file: AntennaFile) -> str:
    """The text of an antenna file, with units in the comments."""
    document = tomlkit.document()
    document.add(
        tomlkit.comment("How received power falls with distance, as calibrated. Written by fieldkit.")
    )
    document["schema"] = SCHEMA
    document["model"] = file.model
    notes = {
        "path_loss_exponent": "beta",
        "power_at_1m_dbm": "mean reading at 1 m from the calibrated transmitter",
        "sigma_db": "standard deviation of one reading",
        "threshold_dbm": "zeta: the strongest integer reading that is not received",
        "saturation_dbm": "readings are never reported above this",
    }
    parameters = tomlkit.table()
    for name, value in asdict(file.antenna).items():
        if value is not None:
            parameters.add(name, value)
            parameters.value.item(name).comment(notes[name])  # type: ignore[union-attr]
    document["parameters"] = parameters
    document["verdict"] = {"state": file.verdict, "reasons": list(file.reasons)}
    if file.intervals_95:
        document["intervals_95"] = {name: list(pair) for name, pair in file.intervals_95.items()}
    for name in ("pattern", "covariance", "data", "radio"):
        if getattr(file, name):
            document[name] = getattr(file, name)
    return tomlkit.dumps(document)
