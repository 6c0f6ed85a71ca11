"""A recording, shown: the same frames a live page had, one a second, with a time to go to and a speed to play at."""

import asyncio
import heapq
from collections.abc import Iterable, Iterator
from operator import itemgetter
from typing import Any, TypeVar

from fieldkit.clock import RealClock
from fieldkit.messages import Tick
from fieldkit.recording.reader import Recording
from mission.maps.background import background_or_none
from mission.page.commands import Pause, Play, Question, Seek
from mission.page.protocol import Heard, History, News, Note, Point, text_of
from mission.page.server import Mailbox
from mission.page.view import KEPT, SERIES_POINTS, View
from mission.replay.replay import recorded_mission

MOST_FRAMES = 4000
"""Frames kept; a recording longer than this many seconds gets one every few seconds."""
PLAY_S = 0.2
"""Wall seconds between frames while playing."""
SLOWEST, FASTEST = 0.1, 100.0

Row = TypeVar("Row", Heard, Note, Point)


class PastShow:
    """A `Show` of a recording, made once from the whole recording."""

    def __init__(self, recording: Recording, *, has_report: bool = False) -> None:
        mission = recorded_mission(recording)
        view = View(mission, kept=None)
        self.background = background_or_none(mission)
        view.background = None if self.background is None else self.background.described()
        if has_report:
            view.files.append(("report", "report.html"))
        self.duration_s = float(recording.summary()["duration_s"])
        every_s = max(1.0, self.duration_s / MOST_FRAMES)
        self.frames: list[tuple[float, str]] = []
        """(s, text)."""
        self.grids: list[tuple[float, str, str]] = []
        """(s, name, text)."""
        next_s = 0.0
        for item in _stream(recording):
            _apply(view, item)
            if item[1] != "event" or not isinstance(item[2].value, Tick):
                continue
            frame = view.frame()
            if frame["t_s"] >= next_s:
                next_s = frame["t_s"] + every_s
                self.frames.append((frame["t_s"], text_of(frame)))
                self.grids += [(frame["t_s"], each["name"], text_of(each)) for each in view.grids()]
        last = view.frame()  # what came with the last tick, and after it
        self.frames.append((last["t_s"], text_of(last)))
        self.grids += [(last["t_s"], each["name"], text_of(each)) for each in view.grids()]
        self.view = view
        self.hello = text_of(view.past_hello(self.duration_s))
        self._players: dict[Mailbox, asyncio.Task[None]] = {}
        self._at_s: dict[Mailbox, float] = {}

    def open(self, mailbox: Mailbox) -> None:
        self._at_s[mailbox] = self.duration_s
        mailbox.put("hello", self.hello)

    def close(self, mailbox: Mailbox) -> None:
        self._stop(mailbox)
        self._at_s.pop(mailbox, None)

    def asked(self, mailbox: Mailbox, question: Question) -> None:
        """Go to a time, play from there, stop playing."""
        match question:
            case Seek(t_s=t_s):
                self._seek(mailbox, t_s)
            case Play(rate=rate):
                self._stop(mailbox)
                rate = min(max(rate, SLOWEST), FASTEST)
                self._players[mailbox] = asyncio.create_task(self._play(mailbox, rate))
            case Pause():
                self._stop(mailbox)
            case _:
                pass

    def _stop(self, mailbox: Mailbox) -> None:
        if (task := self._players.pop(mailbox, None)) is not None:
            task.cancel()

    async def _play(self, mailbox: Mailbox, rate: float) -> None:
        if self._at_s[mailbox] >= self.duration_s - 1.0:
            self._seek(mailbox, 0.0)
        while self._at_s[mailbox] < self.duration_s:
            await RealClock().sleep(PLAY_S)
            self._go_on(mailbox, min(self._at_s[mailbox] + rate * PLAY_S, self.duration_s))

    def _seek(self, mailbox: Mailbox, t_s: float) -> None:
        """Everything anew, as it was then."""
        t_s = min(max(t_s, 0.0), self.duration_s)
        self._at_s[mailbox] = t_s
        view = self.view
        history: History = {
            "kind": "history",
            "tracks": {
                name: [point for point in track if point[0] <= t_s] for name, track in view.tracks.items()
            },
            "series": _until(view.series, t_s, SERIES_POINTS),
            "detections": _until(view.detections, t_s, KEPT),
            "notes": _until(view.notes, t_s, KEPT),
        }
        mailbox.put("history", text_of(history))
        for name in ("belief", "exposure"):
            texts = [text for at_s, called, text in self.grids if called == name and at_s <= t_s]
            if texts:
                mailbox.put(f"grid {name}", texts[-1])
        if frames := [text for at_s, text in self.frames if at_s <= t_s] or [t for _, t in self.frames[:1]]:
            mailbox.put("frame", frames[-1])

    def _go_on(self, mailbox: Mailbox, t_s: float) -> None:
        """What has come since the time shown."""
        before_s, self._at_s[mailbox] = self._at_s[mailbox], t_s
        for at_s, name, text in self.grids:
            if before_s < at_s <= t_s:
                mailbox.put(f"grid {name}", text)
        passed = [text for at_s, text in self.frames if before_s < at_s <= t_s]
        if passed:
            mailbox.put("frame", passed[-1])
        view = self.view
        news: list[News] = []
        news += [{"kind": "news", "detection": row} for row in _between(view.detections, before_s, t_s)]
        news += [{"kind": "news", "note": row} for row in _between(view.notes, before_s, t_s)]
        news += [{"kind": "news", "point": row} for row in _between(view.series, before_s, t_s)]
        for each in news:
            mailbox.add(text_of(each))


def _stream(recording: Recording) -> Iterator[tuple[int, str, Any]]:
    """Everything in the order of time: (log time, family, item)."""
    items = ((item.log_time_ns, item.kind, item) for item in recording.items())
    grids = ((each.log_time_ns, "grid", each) for each in recording.beliefs())
    return heapq.merge(items, grids, key=itemgetter(0))


def _apply(view: View, entry: tuple[int, str, Any]) -> None:
    at_ns, kind, item = entry
    match kind:
        case "event":
            view.event(item.inbox_number, at_ns, item.value)
        case "command":
            view.command(item.inbox_number, at_ns, item.value, item.origin)
        case "detection":
            view.detection(item.inbox_number, at_ns, item.value)
        case "sources":
            view.sources(item.inbox_number, at_ns, item.value)
        case "plan":
            view.plan(item.inbox_number, at_ns, item.value)
        case "belief":
            view.belief(item.inbox_number, at_ns, numbers=item.value.values)
        case "note":
            view.note(item.value.level, item.value.text, at_ns)
        case "grid":
            view.belief(0, at_ns, item.values, cell_m=item.cell_m)
        case _:
            pass


def _until(rows: Iterable[Row], t_s: float, most: int) -> list[Row]:
    """The last rows up to a time."""
    return [row for row in rows if row["t_s"] <= t_s][-most:]


def _between(rows: Iterable[Row], after_s: float, t_s: float) -> list[Row]:
    return [row for row in rows if after_s < row["t_s"] <= t_s]
