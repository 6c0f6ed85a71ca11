"""A recorded mission through the same kernel and safety again: the same belief and commands, bit for bit, or the
first event where they differ."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from fieldkit.channel.antenna_file import AntennaFile, parse_antenna
from fieldkit.clock import wall_s
from fieldkit.errors import ConfigError, DataError, RecordingError, ReplayMismatch
from fieldkit.messages import Command, Event
from fieldkit.recording.made_with import differences
from fieldkit.recording.reader import Recording, Step, open_recording
from fieldkit.tuning import Tuning
from mission.core.defaults import filled_in
from mission.core.kernel import Kernel, Outcome, state_digest
from mission.core.mission_file import Mission, assemble, parse_mission
from mission.core.tables import MissionFile
from mission.safety.rules import Safety
from mission.shell.recorder import Follower, MissionRecorder

WHAT_IF = ("engine", "sources", "association", "end", "safety", "tuning")
"""Tables of the mission file that a what-if may change: the field, robots and antenna file are what was there."""


@dataclass(frozen=True, slots=True)
class Replayed:
    """What replaying gave."""

    kernel: Kernel
    safety: Safety
    events: int
    duration_s: float
    """Mission time between the first and last event."""
    wall_s: float
    complete: bool
    """Whether the recording was whole."""
    missing: str
    compared: int = 0
    """Events whose consequences were compared with the recorded ones."""


def recorded_mission(
    recording: Recording, antenna: AntennaFile | None = None, antenna_text: str = ""
) -> Mission:
    """The mission a recording was made with, or the same with another antenna. Raises `RecordingError`."""
    import tomllib

    if not recording.mission_toml or not recording.antenna_toml:
        raise RecordingError(
            f"{recording.path}: it holds no mission and antenna file, so it cannot be replayed"
        )
    where = f"{recording.path} (recorded mission.toml)"
    made = f"fieldkit {recording.fieldkit_version}, which made it, can replay it"
    try:
        text = filled_in(recording.mission_toml, recording.metadata.get("defaults", {}))
        tuning = Tuning().with_tables(recording.metadata.get("tuning", {}))
    except ValueError as error:
        raise RecordingError(f"{where}: {error}; {made}") from error
    try:
        file = parse_mission(text, where)
    except ConfigError as error:
        raise RecordingError(f"{error}; {made}") from error
    if antenna is None:
        antenna_text = recording.antenna_toml
        antenna = parse_antenna(tomllib.loads(antenna_text), f"{recording.path} (recorded antenna.toml)")
    return assemble(_with_its_ground(file, recording), text, antenna, antenna_text, where, tuning)


def _with_its_ground(file: MissionFile, recording: Recording) -> MissionFile:
    """With the picture under the map where it was when the mission was flown, unless it lies beside the recording."""
    field, there = file.field, recording.metadata.get("background")
    if (
        not (field.background and isinstance(there, str))
        or (recording.path.parent / field.background).is_file()
    ):
        return file
    return file.model_copy(update={"field": field.model_copy(update={"background": there})})


def resumable(recording: Recording) -> Mission:
    """The mission of an interrupted recording. Raises `RecordingError` where there is nothing to go on with."""
    if (result := recording.result()) is not None:
        raise RecordingError(
            f"{recording.path}: that mission is over ({result.get('end_reason', 'ended')}); nothing to resume"
        )
    if "agent" in recording.metadata:
        raise RecordingError(f"{recording.path}: is an agent's: 'fieldkit agent' goes on by itself")
    return recorded_mission(recording)


def same_antenna(recording: Recording, mission: Mission, given: Path) -> None:
    """Raise `DataError` where an antenna file is not the one the mission was flown with, naming what differs."""
    flown = asdict(recorded_mission(recording).antenna.antenna)
    differing = [
        f"{name} {flown[name]} recorded, {value} given"
        for name, value in asdict(mission.antenna.antenna).items()
        if flown[name] != value
    ]
    if differing:
        raise DataError(
            f"{given}: not the calibration this mission was flown with ({'; '.join(differing)}), so replaying "
            "cannot give the same; leave --antenna out, or add --what-if to see what it gives"
        )


def replay(
    log: Path | Recording,
    *,
    mission: Mission | None = None,
    check: bool = True,
    until_s: float | None = None,
    on_step: Callable[[float, Event, Outcome, Kernel], None] | None = None,
    followers: Sequence[Follower] = (),
) -> Replayed:
    """Feed the recorded inbox of `log` through a fresh kernel and safety.

    With `check`, every command and every recorded belief digest must come out the same: `ReplayMismatch` names the
    first event that differs. Without, the outcome is a what-if: another antenna, belief or planner on the same inbox.
    `on_step` is called after each event with its mission time, to pace a replay. `followers` are given everything as
    the mission's own would be: a live page, another recording.
    """
    recording = log if isinstance(log, Recording) else open_recording(log)
    mission = mission or recorded_mission(recording)
    kernel, safety = Kernel(mission.kernel), Safety(mission.safety)
    expected = _Expected(recording) if check else None
    recorder = MissionRecorder(kernel, mission.kernel.engine.grid.cell_m, *followers) if followers else None
    began = wall_s()
    count, first_ns, last_ns = 0, None, 0
    for step in recording.steps():
        first_ns = step.log_time_ns if first_ns is None else first_ns
        t_s = (step.log_time_ns - first_ns) * 1e-9
        if until_s is not None and t_s > until_s:
            break
        last_ns = step.log_time_ns
        count += 1
        outcome = kernel.step(step.event)
        given: list[tuple[str, Command]] = [("safety", command) for command in safety.observe(step.event)]
        for asked, allowed in zip(outcome.commands, safety.judge(outcome.commands), strict=True):
            given += [("kernel", asked), ("safety", allowed)]
        if expected is not None:
            expected.compare(step, given, kernel)
        if recorder is not None:
            _record(recorder, step, outcome, given)
        if on_step is not None:
            on_step(t_s, step.event, outcome, kernel)
    if count == 0:
        raise RecordingError(f"{recording.path}: it holds no events")
    if expected is not None and until_s is None:
        expected.compare_end(kernel)
    return Replayed(
        kernel,
        safety,
        count,
        (last_ns - (first_ns or 0)) * 1e-9,
        wall_s() - began,
        recording.complete,
        recording.missing,
        count if expected is None else expected.compared,
    )


def _record(
    recorder: MissionRecorder, step: Step, outcome: Outcome, given: list[tuple[str, Command]]
) -> None:
    recorder.event(step.inbox_number, step.log_time_ns, step.event)
    for origin, command in given:
        recorder.command(
            step.inbox_number, step.log_time_ns, command, "kernel" if origin == "kernel" else "safety"
        )
    recorder.outcome(step.inbox_number, step.log_time_ns, outcome)


class _Expected:
    """Compares what each event led to with what the recording says.

    In a recording that is not whole, only up to the first gap and to the last event whose consequences are there.
    """

    def __init__(self, recording: Recording) -> None:
        self.path = recording.path
        self.compared = 0
        self._recording = recording
        self._whole = recording.complete
        self._next: int | None = None
        self._lost = False

    def compare(self, step: Step, given: list[tuple[str, Command]], kernel: Kernel) -> None:
        """Raise `ReplayMismatch` where this event led to something else than recorded."""
        if self._next is not None and step.inbox_number != self._next and not self._whole:
            self._lost = True
        self._next = step.inbox_number + 1
        if step.known and not self._lost:
            self._check(step, given, kernel.digest() if step.digest else "")

    @property
    def _made_with(self) -> str:
        """What the recording was made with, where that is not what replays it."""
        differing = differences(self._recording.software)
        return f"; {differing}" if differing else ""

    def _check(self, step: Step, given: list[tuple[str, Command]], digest: str) -> None:
        where = f"event {step.inbox_number} ({type(step.event).__name__} at {step.event.t_ns} ns)"
        if step.commands != given:
            raise ReplayMismatch(
                f"{self.path}: {where} led to other commands: recorded {_say(step.commands)}, replayed {_say(given)}"
                f"{self._made_with}"
            )
        if step.digest != digest:
            raise ReplayMismatch(
                f"{self.path}: after {where} the belief differs: recorded {step.digest[:16]}, replayed {digest[:16]}"
                f"{self._made_with}"
            )
        self.compared += 1

    def compare_end(self, kernel: Kernel) -> None:
        """The final digests, where the mission came to its end and nothing of it is missing."""
        result = self._recording.result() if self._whole else None
        if result is not None and result.get("state_hash") != state_digest(kernel):
            raise ReplayMismatch(
                f"{self.path}: the final state differs from the recorded one{self._made_with}"
            )


def _say(commands: list[tuple[str, Command]]) -> str:
    return "; ".join(f"{origin}: {command}" for origin, command in commands) or "none"


def what_if(
    mission: Mission, *, belief: str | None = None, planner: str | None = None, changes: Sequence[str] = ()
) -> Mission:
    """The mission with another belief or planner, or with keys of its file set anew, such as `engine.min_receptions=3`.

    Raises `ConfigError` for a key or value the mission file does not know.
    """
    changes = [*changes, *_named("engine.belief", belief), *_named("engine.planner", planner)]
    if not changes:
        return mission
    text = changed(mission.text, changes)
    file = parse_mission(text, f"{mission.where} with {', '.join(changes)}")
    tuning = mission.kernel.engine.tuning
    return assemble(file, text, mission.antenna, mission.antenna_text, mission.where, tuning)


def _named(key: str, name: str | None) -> list[str]:
    return [] if name is None else [f'{key}="{name}"']


def changed(text: str, changes: Sequence[str]) -> str:
    """A mission file with `table.key=value` set anew; a value is TOML, or a bare word. Raises `ConfigError`."""
    document = tomlkit.parse(text)
    for change in changes:
        path, equals, value = change.partition("=")
        *tables, key = path.strip().split(".")
        if not equals or not tables or not key:
            raise ConfigError(
                f"--set: expected TABLE.KEY=VALUE such as engine.min_receptions=3, got '{change}'"
            )
        if tables[0] not in WHAT_IF:
            raise ConfigError(f"--set {change}: only {', '.join(WHAT_IF)} can be changed after the fact")
        table: Any = document
        for name in tables:
            table = table.setdefault(name, tomlkit.table()) if hasattr(table, "setdefault") else None
            if not hasattr(table, "setdefault"):
                raise ConfigError(f"--set {change}: '{name}' is not a table of the mission file")
        try:
            table[key] = tomlkit.value(value.strip())
        except (TOMLKitError, ValueError):
            table[key] = value.strip()
    return tomlkit.dumps(document)
