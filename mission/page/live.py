"""A mission under way, shown: frames twice a second, news and grids as they come, and what the operator wants."""

import contextlib
from collections import deque
from collections.abc import Callable
from typing import Any

from fieldkit.messages import Event, Tick
from mission.page.commands import Look, Question
from mission.page.disk import DiskWords
from mission.page.protocol import Frame, Grid, Past, text_of
from mission.page.server import Mailbox, Page
from mission.page.view import View, thin

Messages = list[tuple[str, str]]
"""(slot in a mailbox, text)."""
PAST_EVERY_S = 5.0
PAST_FRAMES = 720
"""Frames kept to look back at; when there are more, every second of the older ones goes."""
FRAME_NS = 400_000_000
"""Frames are no nearer to each other, in mission time: ticks are, where receptions are looked at as they come."""


class LiveShow:
    """A `Follower` and a `Show`: takes events in the mission's thread, hands finished texts to the server's."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.page: Page | None = None
        self.disk: DiskWords | None = None
        """What is said of the recording."""
        self.is_over: Callable[[], bool] = lambda: False
        """Whether nobody is steered any more."""
        self._mailboxes: list[Mailbox] = []
        self._newcomers: deque[Mailbox] = deque()
        self._shown_ns = -FRAME_NS
        self._past: list[tuple[float, str]] = []
        """(s, a moment to look back at); replaced when it is thinned, so that another thread may read it."""

    # -- the server's thread ---------------------------------------------------------------------------------

    def open(self, mailbox: Mailbox) -> None:
        """The past is sent at the mission's next tick."""
        mailbox.put("hello", text_of(self.view.hello()))
        self._newcomers.append(mailbox)

    def close(self, mailbox: Mailbox) -> None:
        for waiting in (self._mailboxes, self._newcomers):
            with contextlib.suppress(ValueError):
                waiting.remove(mailbox)

    def asked(self, mailbox: Mailbox, question: Question) -> None:
        """Only `Look` is answered: how it was at a time."""
        if isinstance(question, Look) and (past := self._past):
            earlier = [text for at_s, text in past if at_s <= question.t_s]
            mailbox.put("past", earlier[-1] if earlier else past[0][1])

    def _hand_over(self, now: Messages, news: list[str], newcomers: list[Mailbox], past: Messages) -> None:
        for mailbox in self._mailboxes:
            for slot, text in now:
                mailbox.put(slot, text)
            for text in news:
                mailbox.add(text)
        for mailbox in newcomers:
            for slot, text in past:
                mailbox.put(slot, text)
        self._mailboxes += newcomers

    # -- the mission's thread --------------------------------------------------------------------------------

    def event(self, inbox_number: int, log_time_ns: int, event: Event) -> None:
        self.view.event(inbox_number, log_time_ns, event)
        if isinstance(event, Tick) and abs(log_time_ns - self._shown_ns) >= FRAME_NS:
            self._shown_ns = log_time_ns
            self.publish()

    def waits(self, now_ns: int) -> None:
        """Nothing has begun yet that could be shown; what is known is, with its age."""
        self.view.until(now_ns)
        self.publish()

    def begin(self, start_ns: int) -> None:
        """Time counts from then on. Needed where the mission has been under way for a while."""
        self.view.begin(start_ns)

    def publish(self) -> None:
        """Hand over what is new; nothing is made where nobody looks."""
        news = self.view.news()
        self._remember()
        if self.page is None or not self.page.clients:
            return
        newcomers = [self._newcomers.popleft() for _ in range(len(self._newcomers))]
        past: Messages = []
        if newcomers:
            past = [("history", text_of(self.view.history())), *_texts(self.view.all_grids())]
        present: Frame = {
            **self.view.frame(),
            "viewers": self.page.clients,
            "commanders": self.page.commanders,
            "over": self.is_over(),
        }
        if self.disk is not None:
            present["recording"] = self.disk.now()
        frame = ("frame", text_of(present))
        now = [frame, *_texts(self.view.grids())]
        encoded = [text_of(each) for each in news]
        self.page.call(lambda: self._hand_over(now, encoded, newcomers, [*past, frame]))

    def _remember(self) -> None:
        """Keep the present every few seconds, for whoever looks back later."""
        now_s = self.view.now_s
        if self._past and now_s - self._past[-1][0] < PAST_EVERY_S:
            return
        moment: Past = {"kind": "past", "frame": self.view.frame(), "grids": self.view.all_grids()}
        past = [*self._past, (now_s, text_of(moment))]
        thin(past, PAST_FRAMES)
        self._past = past

    def command(self, *given: Any) -> None:
        self.view.command(*given)

    def detection(self, *given: Any) -> None:
        self.view.detection(*given)

    def sources(self, *given: Any) -> None:
        self.view.sources(*given)

    def plan(self, *given: Any) -> None:
        self.view.plan(*given)

    def belief(self, *given: Any, **more: Any) -> None:
        self.view.belief(*given, **more)

    def note(self, *given: Any) -> None:
        self.view.note(*given)

    def flush(self) -> None:
        self.publish()


def _texts(grids: list[Grid]) -> Messages:
    return [(f"grid {each['name']}", text_of(each)) for each in grids]
