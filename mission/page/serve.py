"""The page beside a mission, and over a recording."""

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

from fieldkit import settings as given
from fieldkit.messages import Operator
from fieldkit.recording.reader import Recording
from fieldkit.recording.writer import RecordingWriter
from mission.core.kernel import Kernel
from mission.core.mission_file import Mission
from mission.maps.background import background_or_none
from mission.page.answers import Answers, Report
from mission.page.disk import DiskWords
from mission.page.live import LiveShow
from mission.page.past import PastShow
from mission.page.protocol import Ends
from mission.page.server import Page
from mission.page.view import View
from mission.safety.rules import Safety
from mission.shell.keyboard import Commanded


class Answering(Protocol):
    """What knows the answers to orders."""

    @property
    def answers(self) -> Mapping[str, tuple[str, str]]:
        """Robot to its last order, and what came of that in words."""
        ...


class Steering(Commanded, Protocol):
    """What a page is attached to: a runner."""

    @property
    def kernel(self) -> Kernel: ...

    @property
    def safety(self) -> Safety: ...

    @property
    def dispatcher(self) -> Answering: ...

    @property
    def recorder(self) -> RecordingWriter: ...

    @property
    def end_reason(self) -> str: ...

    def alarms(self) -> Sequence[str]: ...


class LivePage:
    """A page for one mission. `follower` goes to the runner, which is then attached."""

    def __init__(self, mission: Mission, host: str, port: int) -> None:
        self._runner: Steering | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._where = ""
        view = View(mission, self._answers, alarms=self._alarms)
        self.follower = LiveShow(view)
        background = background_or_none(mission)
        view.background = None if background is None else background.described()
        answers = Answers(mission.frame, view.latest.present, background)
        self.page = Page(self.follower, self._command, host=host, port=port, answers=answers)
        self.follower.page = self.page

    def ends(self, what: Ends) -> None:
        """What End on it ends, where that is not the whole mission. Before anybody looks."""
        self.follower.view.ends = what

    def attach(self, runner: Steering, where: str = "the page") -> None:
        """Commands go to this runner, in the event loop that runs now.

        `where`: whose page this is, for those who read elsewhere who gave an order.
        """
        self._runner, self._loop = runner, asyncio.get_running_loop()
        self._where = where
        self.follower.disk = DiskWords(runner.recorder.path)
        self.follower.is_over = lambda: bool(runner.end_reason)

    def _answers(self) -> Mapping[str, tuple[str, str]]:
        return {} if self._runner is None else self._runner.dispatcher.answers

    def _alarms(self) -> Sequence[str]:
        return [] if self._runner is None else self._runner.alarms()

    def _command(self, command: dict[str, Any]) -> str:
        """In the server's thread: over to the mission's. Why it is refused, or nothing."""
        runner, loop = self._runner, self._loop
        if runner is None or loop is None or loop.is_closed():
            return "the mission is not running"
        robots = runner.mission.kernel.engine.robots
        if command.get("robot") not in (None, *robots):
            return f"there is no robot {command['robot']!r}; robots are: {', '.join(robots)}"
        if command["action"] == "exclude" and (
            why := runner.safety.settings.forbids_closing(command["area_m"])
        ):
            return why
        if command["action"] in ("mark", "bearing") and (why := _why_nowhere(runner, command["robot"])):
            return why

        def put() -> None:
            runner.put(
                Operator(runner.setup.clock.now_ns(), **{"reason": f"operator, on {self._where}"} | command)
            )

        loop.call_soon_threadsafe(put)
        return ""


def _why_nowhere(runner: Steering, robot: str) -> str:
    """Why a person's word of where they stand would name another place; empty where it would not."""
    pose = runner.kernel.robots[robot].pose
    if pose is None:
        return f"where {robot} is, is not known yet: say it again when there is a position"
    age_s = (runner.setup.clock.now_ns() - pose.t_ns) * 1e-9
    if age_s <= runner.safety.settings.pose_timeout_s:
        return ""
    return f"the last position of {robot} is {age_s:.0f} s old: stay here, and say it again when there is a new one"


@contextmanager
def live(mission: Mission, *, host: str = given.PAGE_HOST, port: int = 0) -> Iterator[LivePage]:
    """The page of a mission about to run. Raises `ConfigError` where the port is taken."""
    made = LivePage(mission, host, port)
    with made.page:
        try:
            yield made
        finally:
            made.follower.publish()  # what came after the last tick: how it ended


@contextmanager
def past(
    recording: Recording, *, host: str = given.PAGE_HOST, port: int = 0, report: Report | None = None
) -> Iterator[Page]:
    """The page over a recording; `report` makes what it offers as such. Raises `RecordingError`, `ConfigError`."""
    show = PastShow(recording, has_report=report is not None)
    answers = Answers(show.view.mission.frame, show.view.latest.present, show.background, report)
    with Page(show, host=host, port=port, answers=answers) as page:
        yield page
