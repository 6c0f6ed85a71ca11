"""A recorded mission through the same kernel and safety again: the same belief and commands, bit for bit, or the
first event where they differ."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from fieldkit.antenna.file import AntennaFile, parse_antenna
from fieldkit.clock import wall_s
from fieldkit.errors import DataError, RecordingError, ReplayMismatch
from fieldkit.messages import Command
from fieldkit.recording.reader import Recording, open_recording
from mission.config import Mission, assemble, parse_mission
from mission.kernel import Kernel, state_digest
from mission.safety import Safety


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
    file = parse_mission(recording.mission_toml, where)
    if antenna is None:
        antenna_text = recording.antenna_toml
        antenna = parse_antenna(tomllib.loads(antenna_text), f"{recording.path} (recorded antenna.toml)")
    return assemble(file, recording.mission_toml, antenna, antenna_text, where)


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
    path: Path, *, mission: Mission | None = None, check: bool = True, until_s: float | None = None
) -> Replayed:
    """Feed the recorded inbox through a fresh kernel and safety.

    With `check`, every command and every recorded belief digest must come out the same: `ReplayMismatch` names the
    first event that differs. Without, the outcome is a what-if: another antenna, belief or planner on the same inbox.
    """
    recording = open_recording(path)
    mission = mission or recorded_mission(recording)
    kernel, safety = Kernel(mission.kernel), Safety(mission.safety)
    expected = _Expected(recording) if check else None
    began = wall_s()
    count, first_ns, last_ns = 0, None, 0
    for number, log_ns, event in recording.events():
        first_ns = log_ns if first_ns is None else first_ns
        if until_s is not None and (log_ns - first_ns) * 1e-9 > until_s:
            break
        last_ns = log_ns
        count += 1
        outcome = kernel.step(event)
        given = [("safety", command) for command in safety.observe(event)]
        for command in outcome.commands:
            given += [("kernel", command), ("safety", safety.allow(command))]
        if expected is not None:
            expected.compare(number, event, given, kernel)
    if count == 0:
        raise RecordingError(f"{path}: it holds no events")
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
    )


class _Expected:
    """What the recording says each event led to."""

    def __init__(self, recording: Recording) -> None:
        self.path = recording.path
        self._whole = recording.complete
        self._commands: dict[int, list[tuple[str, Command]]] = {}
        for number, _, origin, command in recording.commands():
            self._commands.setdefault(number, []).append((origin, command))
        self._digests = {number: said.digest for number, _, said in recording.digests() if said.digest}
        self._last = max((*self._commands, *self._digests), default=0)
        self._result: dict[str, Any] | None = recording.result()

    def compare(self, number: int, event: Any, given: list[tuple[str, Command]], kernel: Kernel) -> None:
        """Raise `ReplayMismatch` where this event led to something else than recorded.

        Beyond the last record of a cut file nothing is known to compare with.
        """
        if not self._whole and number >= self._last:
            return
        recorded = self._commands.get(number, [])
        if recorded != given:
            raise ReplayMismatch(
                f"{self.path}: event {number} ({type(event).__name__} at {event.t_ns} ns) led to other "
                f"commands: recorded "
                f"{_say(recorded)}, replayed {_say(given)}"
            )
        digest = self._digests.get(number)
        if digest is not None and kernel.digest() != digest:
            raise ReplayMismatch(
                f"{self.path}: after event {number} ({type(event).__name__} at {event.t_ns} ns) the belief "
                f"differs: recorded "
                f"{digest[:16]}, replayed {kernel.digest()[:16]}"
            )

    def compare_end(self, kernel: Kernel) -> None:
        """The final digests, where the mission came to its end."""
        if self._result is not None and self._result.get("state_hash") != state_digest(kernel):
            raise ReplayMismatch(f"{self.path}: the final state differs from the recorded one")


def _say(commands: list[tuple[str, Command]]) -> str:
    return "; ".join(f"{origin}: {command}" for origin, command in commands) or "none"


def what_if(mission: Mission, *, belief: str | None = None, planner: str | None = None) -> Mission:
    """The mission with another belief or planner."""
    kernel = mission.kernel
    return replace(
        mission, kernel=replace(kernel, belief=belief or kernel.belief, planner=planner or kernel.planner)
    )
