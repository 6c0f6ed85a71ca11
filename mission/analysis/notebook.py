"""`fieldkit.plot_field` and `fieldkit.plot_history`: a recording as matplotlib figures."""

from pathlib import Path

from matplotlib.figure import Figure

from fieldkit.recording.log import Log
from mission.analysis import plots
from mission.analysis.history import History, read_history


def plot_field(recording: Path | str | Log) -> Figure:
    """The field from above in metres: belief (log scale), tracks, estimates with 90 % ellipses, truth if known.

    The figure is not known to pyplot: show it with `display(figure)`, or `figure.savefig(path)`. Raises
    `RecordingError` for what is not a recording of a mission.
    """
    return plots.field_map(_read(recording))


def plot_history(recording: Path | str | Log) -> Figure:
    """Against mission time in seconds: P(within one cell) of each source and P(one is left), and the readings in dBm.

    The figure is as that of `plot_field`, and so are the errors.
    """
    history = _read(recording)
    figure = Figure(figsize=(8.4, 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    plots.draw_probability(above, history)
    plots.draw_detections(below, history)
    above.set(xlabel="")
    return figure


def _read(recording: Path | str | Log) -> History:
    return read_history(recording.path if isinstance(recording, Log) else Path(recording))
