"""One HTML page about a calibration that opens offline: the verdict in words, the numbers, the pictures."""

import numpy as np

from calibration import plots
from calibration.embedded import link
from calibration.fit import OUTLIER_SIGMA, FitResult
from calibration.patterns import Pattern
from calibration.profile import profile
from calibration.verdict import Judgement
from fieldkit.look import paper_css, svg

_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Calibration of {{ name }}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>{{ css|safe }}
.verdict { padding: .6rem 1rem; border-radius: .4rem; background: {{ colour }} }
td:nth-child(-n+3) { white-space: nowrap }
.numbers td, .numbers th { text-align: left; vertical-align: top }
code { font-size: .85em; overflow-wrap: anywhere }
</style>
<h1>Calibration of {{ name }}</h1>
<div class="verdict"><strong>{{ judgement.state|capitalize }}.</strong>
{{ meaning }}
{% if judgement.reasons %}<ul>{% for text in judgement.refusals %}<li><strong>Refused:</strong> {{ text }}.</li>
{% endfor %}{% for text in judgement.warnings %}<li>{{ text }}.</li>{% endfor %}</ul>{% endif %}</div>
<h2>Parameters</h2>
<div class="scroll"><table class="numbers"><tr><th>parameter<th>value<th>95 % interval<th>meaning</tr>
{% for row in rows %}<tr>{% for cell in row %}<td>{{ cell }}{% endfor %}</tr>{% endfor %}</table></div>
<p>{{ counts }} Intervals count places, not readings: readings at one spot share its reflections.</p>
{% if split %}<p>{{ split }}</p>{% endif %}
<p>How the numbers were got: interval-censored maximum likelihood; {{ left_out }}</p>
<p>The readings are in this page: <a download="readings.csv.gz" href="{{ data }}">save them as CSV</a>, or
<code>fieldkit calibrate import</code> this page. They came from {{ name }}, SHA-256 <code>{{ sha }}</code>.</p>
<h2>Readings against distance</h2>{{ fit|safe }}
{% if polar %}<h2>Gain by heading</h2><p>{{ shape }}</p>
{{ polar|safe }}{% endif %}
<h2>What the fit leaves over</h2>
<p>Reading minus fitted level; dotted: 95 %. {% if missed %}Missed packets have no residual, so that far away, where
only the strong ones were heard, the points lie above zero although the fit is right.{% endif %}</p>
{% for title, picture in residuals %}<h3>Against {{ title }}</h3>
{{ picture|safe }}{% endfor %}
<h2>How sure each parameter is</h2>
<p>How much worse the fit gets as a parameter moves away, others adjusting; at 1 the 95 % interval ends.</p>
<p>So got, the 95 % intervals are {% for name, low, high in ends %}<code>{{ name }}</code> {{ low }} to {{ high }}
{{- "; " if not loop.last else "." }}{% endfor %} Where they differ from those above, few places or much censoring make
the likelihood lopsided: trust these.</p>
{{ profiles|safe }}
</html>
"""
_MEANING = {
    "accepted": "A mission can rely on these numbers.",
    "accepted with warnings": "A mission can use these numbers; mind what is said below.",
    "refused": "These readings cannot carry a calibration; the numbers below are for finding out why.",
}
_COLOUR = {"accepted": "#e3f4e6", "accepted with warnings": "#fdf3d8", "refused": "#fbe0e0"}
_PARAMETERS = (
    ("path_loss_exponent", "", "how fast level falls with distance: 10 times this per decade, in dB"),
    ("power_at_1m_dbm", " dBm", "mean reading at 1 m"),
    ("sigma_db", " dB", "standard deviation of one reading, places included"),
    ("threshold_dbm", " dBm", "strongest reading that is not received"),
)


def _row(result: FitResult, name: str, unit: str, meaning: str) -> tuple[str, str, str, str]:
    low, high = result.intervals_95[name]
    value = f"{getattr(result.antenna, name):.2f}{unit}"
    if name == "threshold_dbm" and not result.threshold.identified:
        return name, value, f"somewhere under {high:.0f}", "no packet was missed, so it is not known"
    if low == high:
        return name, value, "exact", f"{meaning}; a whole number that the missed packets leave no doubt about"
    return name, value, f"{low:.2f} to {high:.2f}", meaning


def _end(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "without end"


def _shape(pattern: Pattern) -> str:
    tried = ", ".join(f"{name} {value:.0f}" for name, value in pattern.bic.items())
    return (
        f"{pattern.name.capitalize()}, {np.ptp(pattern.table()[1]):.1f} dB from its weakest to its best side; the "
        f"band holds 95 %. Bayesian information criterion, least is best: {tried}."
    )


def _left_out(result: FitResult) -> str:
    count = f"{result.n_outliers} readings more than {OUTLIER_SIGMA:g} sigma from the fit were left out"
    lost = (
        f", and {result.n_lost_near} packets missed where all should be heard" if result.n_lost_near else ""
    )
    return f"{count}{lost}." if result.n_outliers or lost else "no reading was left out as an outlier."


def report_html(result: FitResult, judgement: Judgement, pattern: Pattern | None = None) -> str:
    """The page as text."""
    from jinja2 import Environment

    rows = [_row(result, *parameter) for parameter in _PARAMETERS]
    if result.antenna.saturation_dbm is not None:
        level = f"{result.antenna.saturation_dbm:.0f} dBm"
        rows.append(
            ("saturation_dbm", level, f"{result.n_saturated} readings", "stronger ones are reported so")
        )
    for receiver, (value, half) in result.receiver_offsets_db.items():
        first = result.readings.receivers[0]
        interval = f"{value - half:.1f} to {value + half:.1f}"
        rows.append(
            (f"receiver {receiver}", f"{value:+.1f} dB", interval, f"how much more than {first} it reports")
        )
    curves = [profile(result, name) for name, _, _ in _PARAMETERS[:3]]
    split = ""
    if result.sigma_time_db is not None and result.sigma_place_db is not None:
        split = (
            f"At one place readings vary by {result.sigma_time_db:.1f} dB over time; "
            f"from place to place by {result.sigma_place_db:.1f} dB."
        )
    return (
        Environment(autoescape=True)
        .from_string(_PAGE)
        .render(
            css=paper_css(),
            name=result.readings.name,
            judgement=judgement,
            meaning=_MEANING[judgement.state],
            colour=_COLOUR[judgement.state],
            rows=rows,
            split=split,
            missed=result.n_missed,
            data=link(result.readings),
            sha=result.readings.sha256 or "not known",
            left_out=_left_out(result),
            counts=f"{result.n_readings} readings, {result.n_missed} missed, {result.n_places} places.",
            profiles=svg(plots.profile_figure(curves)),
            ends=[(curve.name, *map(_end, curve.interval_95)) for curve in curves],
            polar="" if pattern is None else svg(plots.polar_figure(pattern)),
            shape="" if pattern is None else _shape(pattern),
            fit=svg(plots.fit_figure(result)),
            residuals=[(title, svg(figure)) for title, figure in plots.residual_figures(result).items()],
        )
    )
