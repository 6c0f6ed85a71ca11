"""A recording names the code that made it, also where two states of it have one version number."""

import shutil
import subprocess
from pathlib import Path

import pytest

from fieldkit.recording.made_with import DECIDING, ROOT, code_of, commit_of, differences, software


def tree(folder: Path, engine: bytes = b"x = 1\n", page: bytes = b"y = 1\n") -> Path:
    for name, text in (("fieldkit/engine/a.py", engine), ("mission/page/b.py", page)):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_bytes(text)
    for part in DECIDING:
        if part.endswith(".py"):
            (folder / part).write_bytes(b"")
        else:
            (folder / part).mkdir(parents=True, exist_ok=True)
    return folder


def test_the_code_is_what_decides_and_nothing_else(tmp_path: Path) -> None:
    one = code_of(tree(tmp_path / "one"))
    assert code_of(tree(tmp_path / "same", page=b"y = 2\n")) == one, "the page decides nothing"
    assert code_of(tree(tmp_path / "windows", engine=b"x = 1\r\n")) == one, "a checkout with other line ends"
    assert code_of(tree(tmp_path / "other", engine=b"x = 2\n")) != one


def test_everything_that_decides_is_where_it_is_looked_for() -> None:
    assert software()["code"] == code_of(ROOT) and len(code_of(ROOT)) == 12


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_the_commit_is_what_git_says(tmp_path: Path) -> None:
    def git(*words: str, at: Path = tmp_path / "one") -> str:
        named = ("-c", "user.name=a", "-c", "user.email=a@b", "-C", str(at))
        return subprocess.run(
            ["git", *named, *words], check=True, capture_output=True, text=True
        ).stdout.strip()

    (tmp_path / "one").mkdir()
    git("init", "-q")
    assert commit_of(tmp_path / "one") == "", "nothing is committed yet"
    git("commit", "-q", "--allow-empty", "-m", "first")
    first = git("rev-parse", "HEAD")
    assert commit_of(tmp_path / "one") == first
    git("pack-refs", "--all")
    assert commit_of(tmp_path / "one") == first
    git("worktree", "add", "-q", "-b", "side", str(tmp_path / "two"))
    git("commit", "-q", "--allow-empty", "-m", "second", at=tmp_path / "two")
    assert commit_of(tmp_path / "two") == git("rev-parse", "side") != first
    git("checkout", "-q", "--detach")
    assert commit_of(tmp_path / "one") == first
    assert commit_of(tmp_path) == ""


def test_what_differs_is_named_with_what_can_replay_it() -> None:
    here = software()
    assert differences(here) == ""
    said = differences(here | {"code": "0123456789ab", "commit": "f" * 40})
    assert f"code 0123456789ab (here {here['code']})" in said
    assert said.endswith(f"; fieldkit {here['fieldkit']}, commit {'f' * 12}, can replay it")
    unnoted = {name: value for name, value in here.items() if name not in ("code", "commit")}
    assert differences(unnoted).endswith(
        f"code not noted (here {here['code']}); fieldkit {here['fieldkit']}, as it was then, can replay it"
    )
    older = differences(here | {"fieldkit": "0.0.9", "code": "0123456789ab"})
    assert older.endswith("; fieldkit 0.0.9 can replay it")
    assert differences({"numpy": "1.0"}).count("numpy 1.0 (here ") == 1
