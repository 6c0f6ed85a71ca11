"""What a team of agents observed, laid together from their journals: the recording that one computer would have made.

Every agent's journal holds the numbered logs of all robots, as far as it knew them (`mission.shell.journal`). Laid
together they are stepped through the kernel in the order that all agents keep: what many have is taken in once, up to
the last moment that anybody knew of. What agents wrote down that they believed in the end is compared.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path
from typing import Any

from fieldkit.engine.decentralised.logs import NEVER, TICK_NS, Key, Log, Logs
from fieldkit.errors import DataError, FieldkitError, RecordingError
from fieldkit.messages import Operator
from fieldkit.recording.reader import open_recording
from fieldkit.settings import TICK_S
from mission.core.kernel import Kernel
from mission.core.mission_file import Mission
from mission.core.timeline import Timeline
from mission.replay.missions import began_ns, missions
from mission.replay.replay import recorded_mission
from mission.shell import journal as journals
from mission.shell.agent_flight import hash_of
from mission.shell.chronicle import common_of
from mission.shell.recorder import recording_of

RECORDINGS = ("mission.mcap", "common.mcap")
"""Beside a journal; either holds the mission and the antenna file."""
STEP_TICKS = 100
"""Between two words on how far it has come."""
WORTH_SAYING_S = 5.0
"""A robot's own knowledge that ends so much before the others' end is said to be missing."""

NO_ROBOT = "a computer that watched"
"""Whose journal it is where its head names no robot."""

Progress = Callable[[float, str], None]
"""Share done, and words."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One agent's run, from its start to its end or until it was killed."""

    journal: Path
    head: journals.Head
    logs: Logs
    """All that it knew."""
    is_ended: bool
    damage: str
    ended: dict[str, Any] | None
    """The result that it wrote down; None where it could not."""


@dataclass
class Collected:
    """What came of it."""

    out: Path
    mission: str
    robots: dict[str, dict[str, Any]]
    """Robot to how many observations of it are known and up to when, and whether its own journal is here."""
    journals: list[str]
    notes: list[str] = field(default_factory=list)
    """What is missing or contradicts, in words."""
    refused: list[str] = field(default_factory=list)
    """What was not taken in, and why."""
    observations: int = 0
    given: int = 0
    """Observations in all journals; what is more than `observations` was known to several."""
    orders: int = 0
    """Operators' orders; one that several robots wrote down is one."""
    compared: int = 0
    """Journals whose last common belief was compared."""
    agreeing: int = 0
    """... and was, bit for bit, that of the merged observations."""
    belief_hash: str = ""
    end_reason: str = ""


def collect(out: Path, places: Sequence[Path], report: Progress = lambda share, words: None) -> Collected:
    """Lay together what lies in files and folders; the merged recording is written to `out`, which must not exist.

    Raises `DataError` where there is no journal of an agent, or none that can be read.
    """
    paths, refused = _journals(places)
    heads: dict[Path, journals.Head] = {}
    for path in paths:
        try:
            heads[path] = journals.head_of(path)
        except FieldkitError as error:
            refused.append(str(error))
    known, problems = _first_with_mission(heads)
    if known is None:
        raise DataError("no agent's journal could be taken in: " + "; ".join([*refused, *problems]))
    first, mission = known
    flights: list[Flight] = []
    for path, head in heads.items():
        try:
            flights.append(_read(path, head, mission, first))
        except FieldkitError as error:
            refused.append(str(error))
    if not flights:
        raise DataError("no agent's journal could be taken in: " + "; ".join(refused))
    flights, others = _of_the_latest(flights, round(mission.kernel.max_duration_s * 1e9))
    refused += others
    robots = mission.kernel.engine.robots
    whole, contradictions = lay_together([flight.logs for flight in flights], robots)
    done = Collected(
        out,
        mission.file.name,
        _known(whole, flights, robots),
        [str(flight.journal) for flight in flights],
        contradictions + _missing(whole, flights, robots),
        refused,
        sum(map(len, whole.entries.values())),
        sum(len(log) for flight in flights for log in flight.logs.entries.values()),
        len(operators_orders(whole)),
    )
    _write(mission, whole, flights, done, report)
    return done


# -- what there is -----------------------------------------------------------------------------------------


def _journals(places: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """The journals in these places, each once; places without one, in words."""
    found: dict[Path, Path] = {}
    refused = []
    for place in places:
        beside = place.with_name(journals.NAME) if place.is_file() else place / journals.NAME
        if place.is_file() and place.suffix != ".mcap":
            paths = [place]
        elif beside.is_file():
            paths = [beside]
        else:
            paths = sorted(place.rglob(journals.NAME)) if place.is_dir() else []
        if not paths:
            what = (
                "there is no such file or folder"
                if not place.exists()
                else f"no agent's {journals.NAME} is there"
            )
            refused.append(
                f"{place}: {what}; give the folder of an agent's run, or one with such folders in it"
            )
        for path in paths:
            found.setdefault(path.resolve(), path)
    return list(found.values()), refused


def _first_with_mission(
    heads: Mapping[Path, journals.Head],
) -> tuple[tuple[journals.Head, Mission] | None, list[str]]:
    """The first journal with its mission beside it; that is of the others like it too. Else None, and why."""
    problems: list[str] = []
    for path, head in heads.items():
        try:
            return (head, _mission_beside(path, head)), problems
        except FieldkitError as error:
            problems.append(str(error))
    return None, problems


def _mission_beside(journal: Path, head: journals.Head) -> Mission:
    """The mission that was flown, from a recording beside the journal that is of the same one."""
    problems = []
    for name in RECORDINGS:
        try:
            recording = open_recording(journal.with_name(name))
            its = hash_of(recording.mission_toml, recording.antenna_toml)
            if its == head.mission_hash:
                return recorded_mission(recording)
        except FieldkitError as error:
            problems.append(str(error))
        else:
            problems.append(
                f"{name} beside it is of another mission or antenna file ({its}, not {head.mission_hash})"
            )
    raise RecordingError(f"{journal}: which mission it is of cannot be known: " + "; ".join(problems))


def _read(path: Path, head: journals.Head, mission: Mission, first: journals.Head) -> Flight:
    """One journal. Raises `RecordingError` for one that does not belong to the first."""
    robots = mission.kernel.engine.robots
    differs = {
        "another mission or antenna file": (head.mission_hash, first.mission_hash),
        "another mission key": (head.team, first.team),
        "another fieldkit": (head.made, first.made),
    }
    for what, (its, ours) in differs.items():
        if its != ours:
            raise RecordingError(f"{path}: it was made with {what} ({its}; the first with {ours}): left out")
    if head.robot and head.robot not in robots:
        raise RecordingError(
            f"{path}: it is of {head.robot!r}, which is not in the mission ({', '.join(robots)})"
        )
    logs = Logs(head.robot, robots)
    _, damage = journals.load(path, logs)
    return Flight(path, head, logs, journals.is_ended(path), damage, _result_beside(path))


def _result_beside(journal: Path) -> dict[str, Any] | None:
    """What it wrote down at its end; a computer that watched has the common recording alone."""
    for name in RECORDINGS:
        try:
            result = open_recording(journal.with_name(name)).result()
        except FieldkitError:
            continue
        if result is not None and "common_tick" in result:
            return result
    return None


def _of_the_latest(flights: Sequence[Flight], most_apart_ns: int) -> tuple[list[Flight], list[str]]:
    """The flights of the latest mission; those of others in words. Two missions fit into no recording."""
    known = [flight.logs for flight in flights]
    latest, *others = missions(known, most_apart_ns)
    words = []
    for group in others:
        at = datetime.fromtimestamp(began_ns(known, group) * 1e-9, UTC)
        words += [
            f"{flights[number].journal}: it is of another mission with the same files, which began at "
            f"{at:%Y-%m-%d %H:%M:%S} UTC: left out, the latest is taken in; give the folders of that one alone"
            for number in group
        ]
    return [flights[number] for number in latest], words


# -- together ----------------------------------------------------------------------------------------------


def lay_together(known: Sequence[Logs], robots: tuple[str, ...]) -> tuple[Logs, list[str]]:
    """All logs as far as anybody knew them; where two have another observation under one number, in words.

    Of two that contradict, the one that more agents have is kept, then the longer one. One that is the beginning of
    another contradicts none: whoever left early knew no more.
    """
    whole, words = Logs(robots[0], robots), []
    for key in Logs.keys(robots):
        best, alike = _kept([logs.entries[key] for logs in known])
        whole.entries[key] = best
        agreeing = [logs for logs, is_alike in zip(known, alike, strict=True) if is_alike]
        whole.closed[key] = max((logs.closed[key] for logs in agreeing), default=NEVER)
        if len(agreeing) < len(known):
            others = [logs.me or NO_ROBOT for logs in known if logs not in agreeing]
            words.append(
                f"{key[0]}'s log of {key[1].name.lower()} is another one in the journal of {', '.join(others)}: were "
                f"there two agents for {key[0]}, or was it ended and started again where nobody knew all of its log? "
                f"The one that more agents have is kept"
            )
    return whole, words


def _kept(versions: Sequence[Log]) -> tuple[Log, list[bool]]:
    """The version of one log that is kept, and whether each of them agrees with it."""
    agree = [[True] * len(versions) for _ in versions]
    for one, other in combinations(range(len(versions)), 2):
        agree[one][other] = agree[other][one] = _agree(versions[one], versions[other])

    def rank(number: int) -> tuple[bool, int, int]:
        size = len(versions[number])
        goes_on = any(
            alike and len(version) > size for alike, version in zip(agree[number], versions, strict=True)
        )
        return not goes_on, sum(agree[number]), size

    best = max(range(len(versions)), key=rank)
    return versions[best], agree[best]


def _agree(one: Log, other: Log) -> bool:
    size = min(len(one), len(other))
    return one[:size] == other[:size]


def _last_tick(whole: Logs, key: Key) -> int:
    log = whole.entries[key]
    return max(whole.closed[key], -(-log[-1].order_ns // TICK_NS) if log else NEVER)


def _end(whole: Logs) -> int:
    """The last tick that anybody knew of."""
    return max(_last_tick(whole, key) for key in whole.entries)


def operators_orders(whole: Logs) -> set[Operator]:
    """What operators ordered. An order of a computer without a log is in the log of every robot that obeyed it.

    Where an agent withdraws its robot at its end, nobody ordered it.
    """
    events = (entry.event for log in whole.entries.values() for entry in log)
    return {event for event in events if isinstance(event, Operator) and event.action != "withdraw"}


def _known(whole: Logs, flights: Sequence[Flight], robots: Sequence[str]) -> dict[str, dict[str, Any]]:
    own = {flight.head.robot for flight in flights}
    known = {}
    for robot in robots:
        tick = whole.closed_of(robot)
        known[robot] = {
            "observations": sum(len(whole.entries[key]) for key in Logs.keys((robot,))),
            "until_s": tick * TICK_S if tick > NEVER else None,
            "own_journal": robot in own,
        }
    return known


def _missing(whole: Logs, flights: Sequence[Flight], robots: Sequence[str]) -> list[str]:
    """What is not here, as far as that can be known."""
    words = [f"{flight.journal}: {flight.damage}" for flight in flights if flight.damage]
    words += [
        f"{flight.journal}: {NO_ROBOT} did not come to its end, still runs, or its journal is cut"
        for flight in flights
        if not flight.head.robot and not flight.is_ended
    ]
    end = _end(whole)
    for robot in robots:
        own = [flight for flight in flights if flight.head.robot == robot]
        count = sum(len(whole.entries[key]) for key in Logs.keys((robot,)))
        before_s = (end - whole.closed_of(robot)) * TICK_S
        until = f"up to {before_s:.0f} s before the end" if before_s > WORTH_SAYING_S else "up to the end"
        if not count:
            words.append(f"{robot}: nobody knows of any observation of it")
        elif not own:
            words.append(
                f"{robot}: its own journal is not here; others knew {count} observations of it, {until}"
            )
        elif before_s > WORTH_SAYING_S:
            words.append(f"{robot}: its observations are known {until}")
        if own and not any(flight.is_ended for flight in own):
            words.append(f"{robot}: its agent did not come to its end, still runs, or its journal is cut")
    return words


# -- the recording -----------------------------------------------------------------------------------------


def _write(
    mission: Mission, whole: Logs, flights: Sequence[Flight], done: Collected, report: Progress
) -> None:
    began = tuple(r for r in mission.kernel.engine.robots if any(whole.entries[k] for k in Logs.keys((r,))))
    if not began:
        raise DataError("the journals hold no observation: " + "; ".join(done.journals))
    line = Timeline(Kernel(mission.kernel), began)
    with recording_of(mission, done.out, {"collected": done.journals}) as writer:
        chronicle = common_of(mission, line, writer)
        _step_through(line, whole, flights, done, report)
        done.belief_hash = line.kernel.digest()
        done.end_reason = line.end_reason or "what the agents knew ends here"
        for note in (*done.notes, *done.refused):
            writer.note("warning", note)
        chronicle.end(line.horizon * TICK_NS, done.end_reason)
    if writer.failure:
        raise RecordingError(writer.failure)


def _step_through(
    line: Timeline, whole: Logs, flights: Sequence[Flight], done: Collected, report: Progress
) -> None:
    """To the end; on the way the belief is compared with what agents had at their last common tick."""
    said: dict[int, list[tuple[str, str]]] = {}
    for flight in flights:
        if flight.ended is not None and flight.ended["common_tick"] > NEVER:
            robot, digest = flight.head.robot or NO_ROBOT, str(flight.ended["common_hash"])
            said.setdefault(int(flight.ended["common_tick"]), []).append((robot, digest))
    first = min(log[0].order_ns for log in whole.entries.values() if log) // TICK_NS
    end = _end(whole)
    for stop in sorted({tick for tick in said if first < tick <= end} | {end}):
        while line.horizon < stop:
            line.step_to(whole, stop, STEP_TICKS)
            report((line.horizon - first) / max(1, end - first), "stepping through what was observed")
        for robot, digest in said.get(stop, ()):
            done.compared += 1
            done.agreeing += line.kernel.digest() == digest
            if line.kernel.digest() != digest:
                done.notes.append(
                    f"{robot}: its last common belief is not that of these observations: its recording or this "
                    "fieldkit is another one"
                )
