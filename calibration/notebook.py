"""`fieldkit.calibrate`: a log of readings to an antenna file, or a clear no, without the command line."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from calibration import output
from calibration.fit import FitResult, Options, fit
from calibration.logs import Reading, read_log
from calibration.patterns import Pattern, fit_pattern
from calibration.verdict import Judgement, judge
from fieldkit import settings as given
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.errors import CalibrationRefused
from fieldkit.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What the readings say of a radio pair, and whether that can be relied on."""

    antenna_file: AntennaFile
    """What a mission reads; written by `save`."""
    result: FitResult
    """The fit itself. Its members may change: they are no part of the public API."""
    judgement: Judgement

    @property
    def verdict(self) -> Literal["accepted", "accepted with warnings", "refused"]:
        return self.judgement.state

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why there are warnings or a refusal, each with what to do."""
        return self.judgement.reasons

    def save(self, path: Path | str) -> Path:
        """Write the antenna file. Raises `CalibrationRefused`, with the reasons, and writes nothing if refused."""
        if self.verdict == "refused":
            raise CalibrationRefused("; ".join(self.reasons))
        write_whole(Path(path), dump_antenna(self.antenna_file))
        return Path(path)


def calibrate(
    readings: Path | str,
    *,
    columns: Mapping[str, str] | None = None,
    where: Mapping[str, str] | None = None,
    missed: Literal["auto", "counted", "none", "uncounted"] = given.MISSED,
    saturation_dbm: float | None = None,
    min_distance_m: float = 0.0,
    receiver_offsets: bool = False,
    pattern: Literal[
        "none", "auto", "circle", "ellipse", "lobe", "dipole", "fourier", "spline"
    ] = given.PATTERN,
    place_cell_m: float | None = None,
    source_m: tuple[float, float] | None = None,
) -> Calibration:
    """Fit received power against distance and judge whether it can be relied on.

    A fit that is refused is returned too: look at `verdict` and `reasons`; `Calibration.save` raises.

    Parameters
    ----------
    readings
        A CSV of readings (columns in the how-to on calibration), a recording (MCAP) or a report (HTML).
    columns
        Our column name to the file's: `{"rss_dbm": "RSSI"}`.
    where
        Keep only rows with these values: `{"room": "room1"}`.
    missed
        Whether packets not received are in the file: counted, none were lost, uncounted, or find out (auto).
    saturation_dbm
        The receiver reports no more than this; None: found from the readings where they pile up.
    min_distance_m
        Nearer readings are left out.
    receiver_offsets
        Also find by how many dB each receiver differs from the first.
    pattern
        Gain by heading, from the column heading_deg; auto chooses the shape by BIC.
    place_cell_m
        Positions in one cell of this size, in metres, are one place; None: positions that are equal are.
    source_m
        East and north of the only transmitter in metres, where the file does not have it.

    Raises
    ------
    DataError
        For a file that cannot be used: it names file, line and remedy.
    CalibrationRefused
        For readings that carry no fit at all.
    """
    how = Reading(columns or {}, where or {}, place_cell_m, source=source_m)
    data, notes = read_log(Path(readings), how)
    data = replace(data, warnings=(*data.warnings, *notes))
    options = Options(missed, saturation_dbm, min_distance_m, receiver_offsets)
    shape: Pattern | None = None
    if pattern == "none":
        result = fit(data, options)
    else:
        result, shape = fit_pattern(data, options, pattern)
    judgement = judge(result)
    return Calibration(output.antenna_file(result, judgement, pattern=shape), result, judgement)


def plot_calibration(calibration: Calibration) -> "Figure":
    """Readings (dBm) against distance (m), the fitted mean with the band of 95 % of readings, and the threshold.

    The figure is not known to pyplot: show it with `display(figure)`, or `figure.savefig(path)`.
    """
    from calibration.plots import fit_figure

    return fit_figure(calibration.result)
