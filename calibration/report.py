"""One HTML page about a calibration that opens offline: the verdict in words, the numbers, the pictures."""

from base64 import b64encode

from calibration import plots
from calibration.fit import FitResult
from calibration.patterns import Pattern
from calibration.profile import profile
from calibration.verdict import Judgement

_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Calibration of {{ name }}</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 50rem; margin: 2rem auto; color: #222 }
table { border-collapse: collapse }
td, th { padding: .2rem .8rem; text-align: left; border-bottom: 1px solid #ddd }
img { max-width: 100% } .verdict { padding: .6rem 1rem; border-radius: .4rem; background: {{ colour }} }
</style>
<h1>Calibration of {{ name }}</h1>
<div class="verdict"><strong>{{ judgement.state|capitalize }}.</strong>
{{ meaning }}
<ul>{% for text in judgement.refusals %}<li><strong>Refused:</strong> {{ text }}.</li>{% endfor %}
{% for text in judgement.warnings %}<li>{{ text }}.</li>{% endfor %}</ul></div>
<h2>Parameters</h2>
<table><tr><th>parameter<th>value<th>95 % interval<th>meaning</tr>
{% for row in rows %}<tr>{% for cell in row %}<td>{{ cell }}{% endfor %}</tr>{% endfor %}</table>
<p>{{ counts }} Intervals count places, not readings: readings at one spot share its reflections.</p>
{% if split %}<p>{{ split }}</p>{% endif %}
<h2>Readings against distance</h2><img alt="fit" src="data:image/png;base64,{{ fit }}">
{% if polar %}<h2>Gain by heading</h2><p>{{ shape }}</p>
<img alt="pattern" src="data:image/png;base64,{{ polar }}">{% endif %}
<h2>What the fit leaves over</h2>
{% for title, picture in residuals %}<h3>Against {{ title }}</h3>
<img alt="residuals against {{ title }}" src="data:image/png;base64,{{ picture }}">{% endfor %}
<h2>How sure each parameter is</h2>
<p>How much worse the fit gets as a parameter moves away, others adjusting; at 1 the 95 % interval ends.</p>
<img alt="profiles" src="data:image/png;base64,{{ profiles }}">
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


def report_html(result: FitResult, judgement: Judgement, pattern: Pattern | None = None) -> str:
    """The page as text."""
    from jinja2 import Environment

    rows = []
    for name, unit, meaning in _PARAMETERS:
        low, high = result.intervals_95[name]
        rows.append((name, f"{getattr(result.antenna, name):.2f}{unit}", f"{low:.2f} to {high:.2f}", meaning))
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
            name=result.readings.name,
            judgement=judgement,
            meaning=_MEANING[judgement.state],
            colour=_COLOUR[judgement.state],
            rows=rows,
            split=split,
            counts=f"{result.n_readings} readings, {result.n_missed} missed, {result.n_places} places.",
            profiles=b64encode(
                plots.profile_png([profile(result, row[0]) for row in _PARAMETERS[:3]])
            ).decode(),
            polar="" if pattern is None else b64encode(plots.polar_png(pattern)).decode(),
            shape="" if pattern is None else f"Chosen: {pattern.name}.",
            fit=b64encode(plots.fit_png(result)).decode(),
            residuals=[
                (title, b64encode(png).decode()) for title, png in plots.residual_pngs(result).items()
            ],
        )
    )
