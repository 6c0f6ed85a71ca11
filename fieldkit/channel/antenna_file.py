"""antenna.toml: what calibration hands to a mission. A file, not an import."""

import tomllib
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomlkit
from numpy.typing import ArrayLike

from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.channel.pattern import dipole_gain_db, lobe_gain_db, table_db
from fieldkit.channel.spread import ChannelSpread, assumed, parse_spread, table_of
from fieldkit.errors import ConfigError
from fieldkit.files import is_stream
from fieldkit.messages import FloatArray

SCHEMA = 2
MODELS = ("omnidirectional", "lobe", "dipole", "tabulated")
SHAPES: dict[str, tuple[str, ...]] = {
    "lobe": ("front_deg", "narrowness", "floor_db", "offset_db"),
    "dipole": ("front_deg", "front_to_back_db", "floor_db", "offset_db"),
}
"""Directional model to the keys of its `pattern.parameters`; `offset_db` makes its gain average zero."""
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
    """One of `MODELS`: how the gain depends on heading."""
    spread: ChannelSpread | None = None
    """What readings have in common beyond the mean law; None: not measured (all files of schema 1)."""
    receivers: dict[str, "Receiver"] = field(default_factory=dict)
    """Each robot's own radio, by the robot's name; who is not named is as the calibrated one."""
    pattern: dict[str, Any] = field(default_factory=dict)
    """family, heading_deg (clockwise from the antenna's front), gain_db, gain_sigma_db (its standard error),
    and parameters for the models in `SHAPES`; empty: the same all round."""


@dataclass(frozen=True, slots=True)
class Receiver:
    """How one robot's radio differs from the calibrated one."""

    offset_db: float = 0.0
    """How much more it reports."""
    threshold_dbm: float | None = None
    saturation_dbm: float | None = None
    offset_measured: bool = True
    """Whether somebody measured the offset, be it 0."""


def spread_of(file: AntennaFile) -> ChannelSpread:
    """The file's spread, or what is assumed where it has none; `assumed` then says so."""
    return file.spread or assumed(file.antenna, file.data)


def gain_db(file: AntennaFile, heading_deg: ArrayLike) -> FloatArray:
    """How much more than all round is heard from `heading_deg` (clockwise from the front), in dB.

    Zero everywhere for an omnidirectional antenna. Gains average zero over the headings.
    """
    if not file.pattern:
        return np.zeros_like(np.asarray(heading_deg, dtype=float))
    if file.model in SHAPES:
        values = [float(file.pattern["parameters"][name]) for name in SHAPES[file.model]]
        return (lobe_gain_db if file.model == "lobe" else dipole_gain_db)(heading_deg, *values)
    return table_db(heading_deg, file.pattern["heading_deg"], file.pattern["gain_db"])


def predictive_sigma_db(
    file: AntennaFile, range_m: ArrayLike, heading_deg: ArrayLike | None = None
) -> FloatArray:
    """Standard deviation of a new reading at `range_m`, given that the parameters are not known exactly, in dB.

    sigma^2 + Var(sigma) + g' C g, with g = (1, -10 log10 range) the mean's derivative by power and exponent and
    C the file's covariance (delta method; exact here, the mean being linear in both). With `heading_deg`, which
    must broadcast with `range_m`, the pattern's own error is added. A file without covariance gives its sigma.
    """
    log_range = np.log10(np.maximum(np.asarray(range_m, dtype=float), MIN_RANGE_M))
    names = list(file.covariance.get("names", ()))
    matrix = np.asarray(file.covariance.get("matrix", np.zeros((0, 0))), dtype=float)

    def covariance(first: str, second: str) -> float:
        known = first in names and second in names
        return float(matrix[names.index(first), names.index(second)]) if known else 0.0

    variance = (
        file.antenna.sigma_db**2
        + covariance("sigma_db", "sigma_db")
        + covariance("power_at_1m_dbm", "power_at_1m_dbm")
        - 20.0 * log_range * covariance("power_at_1m_dbm", "path_loss_exponent")
        + (10.0 * log_range) ** 2 * covariance("path_loss_exponent", "path_loss_exponent")
    )
    if heading_deg is not None and "gain_sigma_db" in file.pattern:
        error = table_db(heading_deg, file.pattern["heading_deg"], file.pattern["gain_sigma_db"])
        variance = variance + error**2
    result: FloatArray = np.sqrt(variance)
    return result


def with_pattern(file: AntennaFile) -> Antenna:
    """The antenna with its gain by heading, for models that know the robots' headings.

    Raises `ConfigError` where the file has none: every bearing would look alike.
    """
    if not file.pattern:
        raise ConfigError(
            "antenna: model: expected a directional antenna (lobe, dipole or tabulated), got 'omnidirectional': "
            "calibrate with headings, or choose sensing 'levels'"
        )
    gains = gain_db(file, np.arange(360.0))
    return replace(file.antenna, pattern_db=tuple(float(gain) for gain in gains))


def read_antenna(
    path: Path | str, *, allow_refused: bool = False, allow_pattern: bool = False
) -> AntennaFile:
    """Read an antenna file. Raises `ConfigError` naming file, key, what was expected and what was there.

    A file whose verdict is `refused` is an error unless `allow_refused`. So is one with a radiation pattern
    unless `allow_pattern`: who reads only `antenna` would take a directional antenna for one that is not.
    """
    path = Path(path)
    if is_stream(path):
        raise ConfigError(f"{path}: expected an antenna file, got a pipe or device")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such antenna file; make one with 'fieldkit calibrate fit'") from None
    except ValueError as error:  # no text, no TOML, or a number of thousands of digits
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
    except RecursionError:
        raise ConfigError(f"{path}: not valid TOML: nested too deeply") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    parsed = parse_antenna(raw, str(path))
    if parsed.pattern and not allow_pattern:
        raise ConfigError(
            f"{path}: model: expected 'omnidirectional', got {parsed.model!r}: this antenna's "
            "gain depends on heading, which this use of it cannot take into account"
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
    if not isinstance(schema, int) or isinstance(schema, bool):
        raise ConfigError(f"{where}: schema: expected the integer {SCHEMA}, got {schema!r}")
    if schema > SCHEMA:
        raise ConfigError(
            f"{where}: schema: {str(schema)[:20]} is newer than this fieldkit knows ({SCHEMA}); update fieldkit"
        )
    model, pattern = raw.get("model", "omnidirectional"), raw.get("pattern", {})
    if model not in MODELS:
        raise ConfigError(f"{where}: model: expected one of {', '.join(MODELS)}, got {model!r}")
    if model != "omnidirectional":
        _check_pattern(pattern, model, where)
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
        covariance=_checked_covariance(raw.get("covariance", {}), state, where),
        data=dict(raw.get("data", {})),
        radio=dict(raw.get("radio", {})),
        model=model,
        spread=parse_spread(raw.get("channel"), where),
        receivers=_receivers(raw.get("receivers", {}), where),
        pattern={} if model == "omnidirectional" else dict(pattern),
    )


def _receivers(table: Any, where: str) -> dict[str, Receiver]:
    """One entry for each robot's radio."""
    if not isinstance(table, dict):
        raise ConfigError(f"{where}: receivers: expected a table for each robot's radio, got {table!r}")
    found = {}
    for name, entry in table.items():
        known = {"offset_db", "threshold_dbm", "saturation_dbm"}
        if not isinstance(entry, dict) or not set(entry) <= known or not all(map(_is_finite, entry.values())):
            raise ConfigError(
                f"{where}: receivers.{name}: expected finite numbers under {', '.join(sorted(known))}, got {entry!r}"
            )
        numbers = {key: float(value) for key, value in entry.items()}
        found[name] = replace(Receiver(**numbers), offset_measured="offset_db" in numbers)  # type: ignore[arg-type]
    return found


def _numbers(radio: Receiver) -> dict[str, float | None]:
    """A radio's entry in the file: an offset that nobody measured is none."""
    return {
        "offset_db": radio.offset_db if radio.offset_measured else None,
        "threshold_dbm": radio.threshold_dbm,
        "saturation_dbm": radio.saturation_dbm,
    }


def _check_pattern(pattern: Any, model: str, where: str) -> None:
    """Equally long lists of numbers, and the parameters of a model that has some."""
    if not isinstance(pattern, dict):
        raise ConfigError(f"{where}: pattern: expected a table for the model {model!r}, got {pattern!r}")
    wanted = ["heading_deg", "gain_db", *(["gain_sigma_db"] if "gain_sigma_db" in pattern else [])]
    lists = [pattern.get(name) for name in wanted]
    columns = [each for each in lists if isinstance(each, list) and all(map(_is_finite, each))]
    if len(columns) != len(wanted) or len({len(each) for each in columns}) != 1 or len(columns[0]) < 4:
        raise ConfigError(
            f"{where}: pattern: expected equally long lists {', '.join(wanted)} of 4 finite numbers or more, "
            f"got {pattern!r}"
        )
    parameters = pattern.get("parameters", {})
    for name in SHAPES.get(model, ()):
        if not isinstance(parameters, dict) or not _is_finite(parameters.get(name)):
            given = parameters.get(name) if isinstance(parameters, dict) else parameters
            raise ConfigError(f"{where}: pattern.parameters.{name}: expected a finite number, got {given!r}")


def _checked_covariance(table: Any, state: str, where: str) -> dict[str, Any]:
    """A square matrix with a name for each row; of finite numbers unless the file was refused anyway."""
    if table == {}:
        return {}
    names = table.get("names") if isinstance(table, dict) else None
    try:
        matrix = np.asarray(table["matrix"], dtype=float)
    except (KeyError, TypeError, ValueError):
        matrix = np.full((0, 1), np.nan)
    known = isinstance(names, list) and matrix.shape == (len(names), len(names))
    if not known or (state != "refused" and not np.all(np.isfinite(matrix))):
        raise ConfigError(
            f"{where}: covariance: expected names and a square matrix of finite numbers, got {table!r}"
        )
    return dict(table)


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e6


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
    for name, value in asdict(replace(file.antenna, pattern_db=(), alike_within_m=0.0)).items():
        if name in (
            "pattern_db",
            "alike_within_m",
        ):  # of the model; the file has its own tables for the pattern
            continue
        if value is not None:
            parameters.add(name, value)
            parameters.value.item(name).comment(notes[name])  # type: ignore[union-attr]
    document["parameters"] = parameters
    document["verdict"] = {"state": file.verdict, "reasons": list(file.reasons)}
    if file.spread is not None:
        document["channel"] = table_of(file.spread)
    if file.receivers:
        document["receivers"] = {
            name: {key: value for key, value in _numbers(radio).items() if value is not None}
            for name, radio in file.receivers.items()
        }
    if file.intervals_95:
        document["intervals_95"] = {name: list(pair) for name, pair in file.intervals_95.items()}
    for name in ("pattern", "covariance", "data", "radio"):
        if getattr(file, name):
            document[name] = getattr(file, name)
    return tomlkit.dumps(document)
