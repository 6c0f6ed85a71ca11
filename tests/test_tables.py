"""Tables on a terminal: whole words, side by side where there is room, else one under the other."""

import pytest

from fieldkit.console import show_table
from mission.cli.campaigns import _of_group, _of_mission, _short

GROUP = {
    "planner": "infogain", "missions": 100, "unfinished": 12, "median_time_s": 1044.5, "worst_time_s": 14_000.0,
    "median_error_m": 12.113, "worst_error_m": 110.25, "false_finds": 3, "mean_duration_s": 1200.0,
}  # fmt: skip
MISSION = {
    "planner": "infogain", "duration_s": 7200.4, "found": 4, "true_sources": 10, "false_finds": 0,
    "localised_all_s": None, "mean_error_m": 0.113, "worst_error_m": None,
}  # fmt: skip


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


def test_comparisons_fit_a_terminal_of_80_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    show_table([_of_group("planner", GROUP)])
    show_table([_of_mission("20260102T030405Z", MISSION)])
    said = lines(capsys)
    assert max(map(len, said)) <= 80
    for whole in ("infogain", "1044 (14000)", "12.11 (110.25)", "20260102T030405Z", "4 of 10"):
        assert any(whole in line for line in said)
    assert not any(":" in line for line in said), "side by side"


def test_where_there_is_no_room_each_is_a_block(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    show_table([_of_mission("[bold]x[/x]", MISSION)])
    said = lines(capsys)
    assert "recording: [bold]x[/x]" in said and "all after, s: -" in said
    show_table([])
    assert lines(capsys) == []


def test_recordings_are_called_by_what_tells_them_apart() -> None:
    assert _short(["/d/runs/a/mission.mcap", "/d/runs/b/mission.mcap"]) == ["a", "b"]
    assert _short(["/d/runs/a/mission.mcap", "/d/old/a/mission.mcap"]) == ["runs/a", "old/a"]
    assert _short(["/d/runs/a/one.mcap"]) == ["a/one.mcap"]
