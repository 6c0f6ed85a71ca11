"""The report: right words for what was found, silent, wrong; also where nothing was heard."""

import shutil
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.errors import ConfigError, RecordingError
from fieldkit.messages import Hold, Operator, Pose, ReceiverState, RssReading, Tick, VehicleState
from fieldkit.recording import RecordingWriter, open_recording
from mission.analysis import plots
from mission.analysis.faults import faults
from mission.analysis.history import read_history
from mission.analysis.next_steps import next_steps
from mission.analysis.pdf import BROWSERS, write_pdf
from mission.analysis.refine import Fit
from mission.analysis.report import searched, write_report
from mission.analysis.use import stretches, use
from mission.lab.synthetic import record_simulated, small_mission


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_simulated(tmp_path_factory.mktemp("log"), seed=2, duration_s=200.0)


@pytest.fixture(scope="module")
def written(log: Path) -> tuple[dict[str, Any], str]:
    """What its report says as data, and the page."""
    path = log.with_name("report.html")
    return write_report(log, path), path.read_text()


class Page(HTMLParser):
    """The page's text, and whatever it would fetch from elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words, self.fetched, self.open = "", [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.open += [] if tag in ("meta", "path", "use", "img", "br") else [tag]
        self.fetched += [v for k, v in attrs if k in ("src", "href", "xlink:href") and v and "://" in v]
        self.fetched += [tag] if tag in ("script", "link", "iframe") else []

    def handle_data(self, data):
        self.words += data


def test_the_page_says_what_was_found_and_fetches_nothing(
    log: Path, written: tuple[dict[str, Any], str]
) -> None:
    said, text = written
    page = Page(text)
    assert page.fetched == []
    result = open_recording(log).result()
    assert f"heard {result['detections']} transmission" in page.words and "searched" in page.words
    assert said["found"] == len(result["found_at_s"])
    assert "a source there that sends every 10 s" in page.words
    for source in said["refined"]:
        assert f"Source {source['ident']}" in page.words


def test_refined_places_are_where_the_sources_are(log: Path, written: tuple[dict[str, Any], str]) -> None:
    history = read_history(log)
    assert written[0]["refined"]
    for source in written[0]["refined"]:
        off = min(
            ((source["east_m"] - t["east_m"]) ** 2 + (source["north_m"] - t["north_m"]) ** 2) ** 0.5
            for t in history.truth
        )
        assert off < max(0.4, 4.0 * source["sigma_m"])


def test_a_mission_with_no_detection_has_a_report_that_says_so(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, robots=2)
    path = tmp_path / "mission.mcap"
    with RecordingWriter(path, mission_toml=mission.text, antenna_toml=mission.antenna_text) as writer:
        for number in range(100):
            t_ns = number * 500_000_000
            writer.event(2 * number, t_ns, Pose(t_ns, "r1", 5.0, 5.0))
            writer.event(2 * number + 1, t_ns, Tick(t_ns))
    said = write_report(path, tmp_path / "report.html")
    words = Page((tmp_path / "report.html").read_text()).words
    assert said["detections"] == said["found"] == 0 and said["refined"] == []
    assert "nothing was heard, so nothing was found" in words and "No source was heard" in words
    assert "The recording ends before the mission did" in words


def test_a_mission_with_no_events_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, robots=2)
    path = tmp_path / "mission.mcap"
    RecordingWriter(path, mission_toml=mission.text, antenna_toml=mission.antenna_text).close()
    with pytest.raises(RecordingError, match="no events"):
        write_report(path, tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()
    done = CliRunner().invoke(build(), ["report", str(path)])
    assert isinstance(done.exception, RecordingError)


def test_faults_are_told_once_each_with_how_long_they_lasted(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "mission.mcap"
    whole = open_recording(log)
    with RecordingWriter(path, mission_toml=whole.mission_toml, antenna_toml=whole.antenna_toml) as writer:
        for number, log_ns, event in whole.events():
            writer.event(number, log_ns, event)
        start = 10_000_000_000
        writer.event(number + 1, start, ReceiverState(start, "r1", False, "unplugged"))
        writer.event(number + 2, start + 7_000_000_000, ReceiverState(start, "r1", True))
        writer.event(number + 3, start, VehicleState(start, "r2", "guided", True, link_up=False))
        for k in range(3):
            writer.command(number, start + k, Hold(start + k, "r3", "no position"), "safety")
        writer.note("error", "the disk is on fire", start)
    history = read_history(path)
    said = [(round(t), who, text) for t, who, text in faults(history)]
    assert (10, "r1", "receiver down for 7 s: unplugged") in said
    assert (10, "r2", "link down to the end") in said
    assert [row for row in said if row[1] == "r3"] == [(10, "r3", "held by safety: no position")]
    assert (10, "", "the disk is on fire") in said
    assert history.down("r1") == [(10.0, 17.0)]
    page = tmp_path / "report.html"
    write_report(path, page)
    assert "the disk is on fire" in page.read_text()


def test_what_robots_did_differs_on_paper_in_black_and_white() -> None:
    looks = plots._looks(["held", "on a candidate", "on a ridge", "searching", "waiting"])
    assert looks["held"].pop("hatch")
    greys = sorted(to_rgb(each["color"]) @ np.array([0.299, 0.587, 0.114]) for each in looks.values())
    assert np.diff(greys).min() > 0.1


def test_a_plot_without_anything_named_has_no_legend_and_warns_nobody(
    recwarn: pytest.WarningsRecorder,
) -> None:
    axes = Figure().add_subplot()
    plots.legend(axes, loc="upper left")
    assert axes.get_legend() is None and not recwarn.list
    axes.plot([0.0], [0.0], label="r1")
    plots.legend(axes, loc="upper left")
    assert axes.get_legend() is not None


def test_shares_of_a_robots_time_make_a_whole(log: Path) -> None:
    history = read_history(log)
    for each in use(history, stretches(history)):
        assert each.on_ridge + each.off_ridge + each.held == pytest.approx(1.0, abs=1e-6)
        assert each.distance_m > 0.0
    readings = [e for _, _, e in open_recording(log).events() if isinstance(e, RssReading)]
    assert sum(history.readings.values()) == len(readings)


def test_what_people_said_stands_apart_from_what_was_found(
    log: Path, written: tuple[dict[str, Any], str], tmp_path: Path
) -> None:
    path = tmp_path / "mission.mcap"
    whole = open_recording(log)
    with RecordingWriter(path, mission_toml=whole.mission_toml, antenna_toml=whole.antenna_toml) as writer:
        for number, log_ns, event in whole.events():
            writer.event(number, log_ns, event)
        at_ns = 30_000_000_000
        writer.event(number + 1, at_ns, Operator(at_ns, "mark", "r1", "page: mark"))
        writer.event(number + 2, at_ns, Operator(at_ns, "bearing", "r2", "bearing 123 degrees"))
        writer.event(number + 3, at_ns, Operator(at_ns, "mark", "nobody"))
    assert [event.robot for _, event in read_history(path).said] == ["r1", "r2", "nobody"]
    page = tmp_path / "report.html"
    said = write_report(path, page)
    words = Page(page.read_text()).words
    assert "What people said" in words and "a transmitter is here" in words and "bearing 123 degrees" in words
    assert said["found"] == 0, "a word finds nothing"
    assert "What people said" not in Page(written[1]).words


def test_the_first_page_says_where_and_what_next(log: Path, written: tuple[dict[str, Any], str]) -> None:
    text = written[1]
    front = Page(text[text.index('<section class="front">') : text.index("</section>")])
    history = read_history(log)
    assert history.found and "What to do next" in front.words
    assert front.words.count("90 % sure") >= len(history.found)
    assert "one is still hidden has a probability of" in front.words or history.left[-1][1] <= 0.05


def test_what_to_do_follows_from_what_is_wrong(log: Path) -> None:
    history = read_history(log)
    covered = searched(history)
    scatter_db = np.tile([-4.0, 4.0], 20)
    good = Fit(scatter_db, np.full(40, 4.0), np.array(["r1"] * 40))
    off = replace(good, residual_db=scatter_db + 8.0)
    assert not any("Calibrate" in step for step in next_steps(history, covered, good))
    assert any("Calibrate" in step for step in next_steps(history, covered, off))
    odd = replace(history.final[0], state="inconsistent", note="it moved")
    wrong = replace(history, estimates=[(0.0, [odd])], left=[(0.0, 0.01)], holds=[])
    (step,) = next_steps(wrong, covered, good)
    assert "Do not trust" in step and "it moved" in step
    assert next_steps(replace(wrong, estimates=[]), covered, good)[0].startswith("Nothing")
    assert "another channel" in next_steps(replace(wrong, estimates=[], detections=[]), covered, good)[0]


def test_a_report_is_printed_as_pdf(log: Path, tmp_path: Path) -> None:
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("no chromium on this machine: apt-get install chromium")
    said = CliRunner().invoke(build(), ["report", str(log), "-o", str(tmp_path / "r.html"), "--pdf"])
    assert said.exit_code == 0, said.output
    printed = (tmp_path / "r.pdf").read_bytes()
    assert printed.startswith(b"%PDF") and printed.count(b"/Type /Page\n") >= 2


def test_without_a_browser_pdf_says_what_to_install(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mission.analysis.pdf.shutil.which", lambda _: None)
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    page = tmp_path / "page.html"
    page.write_text("<p>words</p>")
    with pytest.raises(ConfigError, match="needs Chromium or Chrome, or WeasyPrint"):
        write_pdf(page, tmp_path / "page.pdf")
    assert not (tmp_path / "page.pdf").exists()
