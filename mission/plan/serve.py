"""The editor's page on a port."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fieldkit import settings as given
from mission.page.server import NothingLive, Page
from mission.plan.answers import PlanAnswers
from mission.plan.desk import Desk


@contextmanager
def plan(path: Path, *, host: str = given.PAGE_HOST, port: int = 0) -> Iterator[Page]:
    """The editor of the mission file at `path`, which need not exist. Raises `ConfigError`."""
    answers = PlanAnswers(Desk(path))
    page = Page(NothingLive(), host=host, port=port, answers=answers, front="plan.html")
    answers.token = page.token
    with page:
        yield page
