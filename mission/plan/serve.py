"""The editor's page on a port."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fieldkit import settings as given
from mission.page.server import Mailbox, Page
from mission.plan.answers import PlanAnswers
from mission.plan.desk import Desk


class NothingLive:
    """A `Show` of nothing: a draft has no present."""

    def open(self, mailbox: Mailbox) -> None:
        """Nothing is sent."""

    def close(self, mailbox: Mailbox) -> None:
        """Nothing is kept."""

    def asked(self, mailbox: Mailbox, question: dict[str, Any]) -> None:
        """Nothing is answered."""


@contextmanager
def plan(path: Path, *, host: str = given.PAGE_HOST, port: int = 0) -> Iterator[Page]:
    """The editor of the mission file at `path`, which need not exist. Raises `ConfigError`."""
    answers = PlanAnswers(Desk(path))
    page = Page(NothingLive(), host=host, port=port, answers=answers, front="plan.html")
    answers.token = page.token
    with page:
        yield page
