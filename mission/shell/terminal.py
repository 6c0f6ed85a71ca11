"""What a mission shows in a terminal: progress while it runs, tables when it is over."""

import contextlib
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from fieldkit.checks import Check, worst
from fieldkit.clock import wall_s
from fieldkit.console import is_quiet
from fieldkit.messages import SourceEstimate
from mission.shell.progress import Progress
from mission.shell.unhurried import unhurried_standard_error

PLAIN_EVERY_S = 5.0
"""Wall seconds between lines where the output is not a terminal."""
MOST_TEAMS, MOST_SOURCES = 10, 8
"""Rows of the live panel: what does not fit is counted."""
LEAST_P = 0.05
"""Candidates that are less likely than this are counted, not listed."""


class Watch:
    """Progress on standard error: a live panel on a terminal, a line now and then elsewhere.

    While it shows, nobody who writes there waits for the terminal: steering must not stop because that has.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        quiet = quiet or is_quiet()
        self._console = Console(stderr=True, quiet=quiet)
        self._trouble = Console(stderr=True)
        """What is said even where the rest is silent."""
        self._live = Live(console=self._console, refresh_per_second=4, transient=True)
        self._notes: list[str] = []
        self._last_s = -PLAIN_EVERY_S
        self._unsaid: Progress | None = None
        """The latest state, where its line has not been due."""
        self._alarmed: set[str] = set()
        """What stands: an alarm that has passed and comes again is a new one."""
        self._around = contextlib.ExitStack()

    def __enter__(self) -> Self:
        self._around.enter_context(unhurried_standard_error())
        if self._console.is_terminal and not self._console.quiet:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):
            if self._live.is_started:
                self._live.stop()
            elif self._unsaid is not None:
                self._say(self._unsaid)
        self._around.close()

    def show(self, progress: Progress) -> None:
        """Take in the state after a tick."""
        # A number that grows is no new alarm.
        alarms = {alarm.split(" for ")[0]: alarm for alarm in progress.alarms}
        for name, alarm in alarms.items():
            if name not in self._alarmed and not self._live.is_started:
                line = f"{progress.elapsed_s:6.0f} s  ALARM: {alarm}"
                self._trouble.print(line, style="bold red", markup=False, soft_wrap=True)
        self._alarmed = set(alarms)
        if self._console.quiet:
            return
        for note in progress.notes:
            line = f"{progress.elapsed_s:6.0f} s  {note}"
            if self._live.is_started:
                self._live.console.print(line, highlight=False, markup=False)
            else:
                self._console.print(line, highlight=False, markup=False, soft_wrap=True)
        now_s = wall_s()
        if self._live.is_started:
            self._live.update(_panel(progress))
        elif now_s - self._last_s >= PLAIN_EVERY_S:
            self._last_s = now_s
            self._say(progress)
        else:
            self._unsaid = progress

    def _say(self, progress: Progress) -> None:
        """The one line of a state."""
        self._unsaid = None
        self._console.print(_line(progress), highlight=False, markup=False, soft_wrap=True)


def _found(progress: Progress) -> tuple[int, int]:
    sources = progress.kernel.sources()
    return sum(s.state == "found" for s in sources), sum(s.state != "found" for s in sources)


def _teams(progress: Progress) -> list[tuple[str, str]]:
    """Team to what its robots are doing; one by one where they differ. Held robots have rows of their own."""
    rows = []
    for team in progress.kernel.settings.engine.teams:
        doing = {robot: progress.doing.get(robot, "waiting") for robot in team}
        free = {robot: what for robot, what in doing.items() if ":" not in what}
        same = len(set(free.values())) == 1 and len(free) == len(team)
        if same:
            rows.append((" + ".join(team), next(iter(free.values()))))
        else:
            rows += [(robot, doing[robot]) for robot in team]
    return rows


def _by_interest(sources: Sequence[SourceEstimate]) -> list[SourceEstimate]:
    """Finds first, then by how surely a source is there; candidates that are hardly one are left out."""
    rank = {"found": 0, "removed": 1, "outside": 2, "inconsistent": 3, "candidate": 4}
    seen = [s for s in sources if s.state != "candidate" or s.p_exists >= LEAST_P]
    return sorted(seen, key=lambda s: (rank[s.state], -s.p_exists, s.ident))


def _line(progress: Progress) -> str:
    """All on one line, however long: it goes to a file, where a line is a moment."""
    found, candidates = _found(progress)
    doing = "; ".join(f"{team} {what}" for team, what in _teams(progress))
    return (
        f"{progress.elapsed_s:6.0f} s  {progress.detections:3d} detections  {found} found  "
        f"{candidates} candidates  one still hidden {progress.probability_left:.0%}  {doing}"
    )


def _panel(progress: Progress) -> Group:
    found, candidates = _found(progress)
    head = Text(f"{progress.elapsed_s:6.0f} s   {progress.detections} detections   ", style="bold")
    head.append(f"{found} found", style="bold green" if found else "bold")
    head.append(f"   {candidates} candidates   one still hidden: {progress.probability_left:.0%}")
    table = Table.grid(padding=(0, 2))
    rows = sorted(_teams(progress), key=lambda row: ":" not in row[1])  # whoever is held stands first
    for team, what in rows[:MOST_TEAMS]:
        style = "yellow" if ":" in what else ""
        table.add_row(Text(team, style=style), Text(what, style=style, overflow="ellipsis", no_wrap=True))
    if len(rows) > MOST_TEAMS:
        table.add_row("", Text(f"and {len(rows) - MOST_TEAMS} more", style="dim"))
    sources = Table(show_edge=False, box=None, padding=(0, 2))
    for column in ("source", "east m", "north m", "P", "receptions", "state"):
        sources.add_column(column, justify="right" if column != "state" else "left", no_wrap=True)
    listed = _by_interest(progress.kernel.sources())
    for s in listed[:MOST_SOURCES]:
        style = "green" if s.state == "found" else "yellow" if s.state == "inconsistent" else ""
        sources.add_row(
            str(s.ident),
            f"{s.east_m:.2f}",
            f"{s.north_m:.2f}",
            f"{s.p_here:.2f}",
            f"{s.receptions:.1f}",
            s.state,
            style=style,
        )
    more = len(progress.kernel.sources()) - min(len(listed), MOST_SOURCES)
    alarms = [Text(alarm, style="bold white on red") for alarm in progress.alarms]
    rest = [Text(f"and {more} weaker candidates", style="dim")] if more else []
    return Group(*alarms, head, *([sources] if listed else []), *rest, table)


def result_table(plain: dict[str, Any]) -> None:
    """The demo's table: found against true, on standard output."""
    console = Console()
    table = Table(title=f"seed {plain['seed']}: {plain['end_reason']}", title_justify="left")
    for column in (
        "true east m",
        "true north m",
        "power dB",
        "found east m",
        "found north m",
        "error m",
        "error cells",
        "after s",
    ):
        table.add_column(column, justify="right")
    for row in plain["sources"]:
        found = [
            _number(row[key], digits)
            for key, digits in (
                ("east_m", 2),
                ("north_m", 2),
                ("error_m", 2),
                ("error_cells", 1),
                ("found_after_s", 0),
            )
        ]
        table.add_row(
            f"{row['true_east_m']:.2f}",
            f"{row['true_north_m']:.2f}",
            f"{row['true_power_db']:.0f}",
            *found,
            style="" if row["found"] else "red",
        )
    console.print(table)
    total = sum(row["found"] for row in plain["sources"])
    console.print(
        f"{total} of {len(plain['sources'])} found within one cell, {plain['false_finds']} false; "
        f"{plain['detections']} transmissions heard, {plain['interventions']} safety interventions",
        highlight=False,
    )


def sources_table(sources: list[dict[str, Any]], detections: int = 0) -> None:
    """Estimates as a table on standard output, and below it what is to be said of them."""
    console = Console()
    if not sources:
        heard = (
            f"{detections} transmission{' was' if detections == 1 else 's were'} heard, too few for a source"
            if detections
            else "nothing was heard"
        )
        console.print(heard)
        return
    table = Table(box=None, padding=(0, 1))
    for column in ("source", "state", "east m", "north m", "± m", "P", "heard", "rate Hz"):
        table.add_column(column, justify="left" if column == "state" else "right", no_wrap=True)
    for s in sources:
        table.add_row(
            str(s["ident"]), s["state"], f"{s['east_m']:.2f}", f"{s['north_m']:.2f}", f"{s['sigma_m']:.2f}",
            f"{s['p_within_one_cell']:.2f}", f"{s['receptions']:.1f}", f"{s['rate_hz']:.3f}",
        )  # fmt: skip
    console.print(table)
    for s in sources:
        if s["note"]:
            console.print(Text(f"source {s['ident']}: {s['note']}"))


_COLOURS = {"green": "green", "amber": "yellow", "red": "bold red"}


def checks_table(checks: list[Check]) -> None:
    """Robot by check; below it what is not green, with what to do."""
    console = Console()
    robots = list(dict.fromkeys(check.robot for check in checks))
    names = list(dict.fromkeys(check.name for check in checks))
    table = Table(title=f"before the start: {worst(checks)}", title_justify="left")
    table.add_column("check")
    for robot in robots:
        table.add_column(Text(robot))
    for name in names:
        cells = []
        for robot in robots:
            found = [check for check in checks if (check.robot, check.name) == (robot, name)]
            level = worst(found)
            cells.append(Text(level if found else "", style=_COLOURS[level]))
        table.add_row(name, *cells)
    console.print(table)
    for check in sorted(checks, key=lambda check: check.level != "red"):
        line = f"{check.robot}: {check.name}: {check.found}"
        if check.level != "green":
            line += f". {check.remedy}" if check.remedy else ""
            console.print(Text(f"{check.level:5s}  ", style=_COLOURS[check.level]) + Text(line))


def study_table(result: dict[str, Any]) -> None:
    """A study's scenarios, one a row."""
    console = Console()
    scenarios = result.get("scenarios")
    if not isinstance(scenarios, dict) or not scenarios:
        console.print_json(data=result)
        return
    first = next(iter(scenarios.values()))
    table = Table(
        title=f"{result.get('study', '')}: {result.get('trials', '')} trials each", title_justify="left"
    )
    table.add_column("scenario", no_wrap=True)
    for column in first:
        table.add_column(column.replace("_", " "), justify="right")
    for name, row in scenarios.items():
        shown = [
            f"{v:.3g}"
            if isinstance(v, float) and abs(v) < 10
            else f"{v:.0f}"
            if isinstance(v, float)
            else "-"
            if v is None
            else str(v)
            for v in row.values()
        ]
        table.add_row(name, *shown)
    if "simulated_s_per_s" in result:
        table.caption = f"{result['simulated_s_per_s']:,.0f} simulated seconds a second and core"
        if "against_numpy" in result:
            table.caption += (
                f"; a search is {result['against_numpy']['times_faster']:.1f} times faster than in numpy"
            )
    console.print(table)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
