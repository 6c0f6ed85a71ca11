"""The page of a recording as one piece of HTML that needs no server: it goes into a report, and works without internet.

The page's own modules are inlined under bare names (an import map of data: URLs); `socket.js`, which asks a server, is
replaced by `recorded.js`, which has the answers. The frames are fewer than a dashboard has: a report is sent by mail.
"""

import base64
import html
import json
import re

from fieldkit.look import typeface_css
from fieldkit.recording.reader import Recording
from mission.page.past import PastShow
from mission.page.protocol import GridName, Recorded
from mission.page.server import STATIC
from mission.page.view import KEPT, SERIES_POINTS, TRACK_POINTS

MOST_FRAMES = 150
MODULE = re.compile(r'(from|import\()\s*"\./([a-z-]+)\.js"')
"""How the page's modules import each other."""
NOTHING_STORED = (
    """Object.defineProperty(window, "sessionStorage", { value: { getItem: () => null, setItem() {} } });"""
)
"""A frame of no origin may store nothing, and says so by an error."""


def embedded(recording: Recording) -> str:
    """An `<iframe>` with the page of a recording. Raises `RecordingError`."""
    text = (STATIC / "page.html").read_text(encoding="utf-8")
    style = typeface_css() + (STATIC / "page.css").read_text(encoding="utf-8")
    modules = {path.stem: path.read_text(encoding="utf-8") for path in STATIC.glob("*.js")}
    modules = {name: source for name, source in modules.items() if not name.startswith(("plan", "runs"))}
    modules["socket"] = modules.pop("recorded")
    addresses = {f"fieldkit/{name}.js": _address(source) for name, source in modules.items()}
    # What stands in a script ends where the next "</" stands, whatever the recording's names are.
    data = json.dumps(_data(recording)).replace("<", "\\u003c")
    head = (
        f"<style>{style}</style>"
        f"<script>{NOTHING_STORED}</script>"
        f'<script type="importmap">{json.dumps({"imports": addresses})}</script>'
        f'<script type="application/json" id="recorded">{data}</script>'
    )
    text = text.replace('<link rel="stylesheet" href="typeface.css">', "")
    text = text.replace('<link rel="stylesheet" href="page.css">', head)
    text = text.replace('<link rel="icon" href="icon.svg" type="image/svg+xml">', "")
    start = '<script type="module">import "fieldkit/main.js";</script>'
    text = text.replace('<script type="module" src="main.js"></script>', "").replace(
        "</body>", f"{start}</body>"
    )
    title = "The mission's page, to move about in"
    return f'<iframe title="{title}" sandbox="allow-scripts" srcdoc="{html.escape(text)}"></iframe>'


def _address(source: str) -> str:
    bare = MODULE.sub(lambda found: f'{found[1]} "fieldkit/{found[2]}.js"', source)
    return f"data:text/javascript;base64,{base64.b64encode(bare.encode()).decode()}"


def _data(recording: Recording) -> Recorded:
    """What a server would have answered."""
    show = PastShow(recording)
    view = show.view
    frames = [json.loads(text) for _, text in show.frames]
    every = max(1, len(frames) // MOST_FRAMES)
    grids = [(t_s, name, json.loads(text)) for t_s, name, text in show.grids]
    names: tuple[GridName, ...] = ("belief", "exposure")
    kept = {name: [each for each in grids if each[1] == name] for name in names}
    return {
        "hello": {
            **view.past_hello(show.duration_s),
            "background": None if show.background is None else show.background.inlined(),
            "files": [],
        },
        "tracks": {name: track[-TRACK_POINTS:] for name, track in view.tracks.items()},
        "series": view.series[-SERIES_POINTS:],
        "detections": list(view.detections)[-KEPT:],
        "notes": list(view.notes)[-KEPT:],
        "frames": [*frames[:-1:every], frames[-1]],
        "grids": [
            {"t_s": t_s, "name": name, "grid": grid}
            for name, rows in kept.items()
            for t_s, _, grid in [*rows[: -1 : max(1, len(rows) // 20)], *rows[-1:]]
        ],
    }
