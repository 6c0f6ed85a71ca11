"""A journal that could not be begun as a whole is not gone on with: the one before it knows more."""

import errno
import os
from pathlib import Path

import pytest
from test_agent_runner import KEY, card

from fieldkit.engine.decentralised.logs import Logs
from fieldkit.messages import RssReading
from mission.lab.synthetic import small_mission
from mission.shell import journal as journals
from mission.shell.agent_flight import head_of, interrupted

WRITES = 3
"""The head and two of three parts."""


class Killed(BaseException):
    """Stands in for a kill."""


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), Killed()], ids=["full", "killed"])
def test_one_that_is_cut_while_it_is_begun_does_not_replace_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    mission = small_mission(tmp_path, robots=2)
    mine, out = card(mission), tmp_path / "runs"
    logs = Logs("r1", mission.kernel.engine.robots)
    for number in range(2 * journals.ENTRIES + 1):
        now_ns = mine.started_ns + number * 10**6
        logs.append(RssReading(now_ns, "r1", -50.0), now_ns)

    def begun(name: str) -> journals.Journal:
        (out / name).mkdir(parents=True)
        journal = journals.Journal(out / name / journals.NAME)
        journal.begin(head_of(mine, KEY))
        return journal

    before = begun("1")
    before.write(logs)
    before.close()
    assert interrupted(out, mine, KEY) == before.path
    plain, written = os.write, []

    def write(file: int, data: bytes) -> int:
        written.append(data)
        if len(written) > WRITES:
            raise error
        return plain(file, data)

    monkeypatch.setattr("mission.shell.journal.os.write", write)
    after = begun("2")
    if isinstance(error, Killed):
        with pytest.raises(Killed):
            after.write(logs)
        os.close(after._file)
    else:
        after.write(logs)
        after.end(left=True)
        after.close()
        assert "No space left" in after.failure
    assert interrupted(out, mine, KEY) == before.path
    monkeypatch.undo()
    whole = begun("3")
    whole.write(logs)
    assert interrupted(out, mine, KEY) == whole.path, "also while it is open"
    whole.close()
    assert [path.name for path in (out / "3").iterdir()] == [journals.NAME]


def test_a_journal_takes_no_other_ones_place(tmp_path: Path) -> None:
    journal = journals.Journal(tmp_path / journals.NAME)
    journal.begin(journals.Head("r1", "x"))
    journal.close()
    with pytest.raises(FileExistsError):
        journals.Journal(tmp_path / journals.NAME).begin(journals.Head("r1", "x"))
