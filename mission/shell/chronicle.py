"""A kernel's steps with safety's judgement, written down as a live mission writes its own: to be replayed."""

from collections.abc import Mapping
from typing import Any

from fieldkit.messages import Command, Event, Tick
from fieldkit.recording.writer import RecordingWriter
from mission.core.kernel import Kernel, Outcome, state_digest
from mission.core.mission_file import Mission
from mission.core.timeline import Timeline
from mission.safety.rules import Safety
from mission.shell.recorder import MissionRecorder


def common_of(mission: Mission, line: Timeline, writer: RecordingWriter) -> "Chronicle":
    """What a line of time is stepped through from now on, written down."""
    chronicle = Chronicle(line.kernel, Safety(mission.safety), writer)
    line.witness = chronicle.step
    return chronicle


class Chronicle:
    """Sees every step of one kernel, has safety judge it, and writes both down."""

    def __init__(self, kernel: Kernel, safety: Safety, writer: RecordingWriter) -> None:
        self._kernel, self._safety, self._writer = kernel, safety, writer
        self._records = MissionRecorder(kernel, kernel.settings.engine.grid.cell_m, writer)
        self.steps = 0

    @property
    def failure(self) -> str:
        """Why nothing is written any more; empty while it is."""
        return self._writer.failure

    def step(self, t_ns: int, event: Event, outcome: Outcome) -> list[Command]:
        """An event that was stepped and what it led to; what safety lets pass of that."""
        records = self._records
        self.steps += 1
        number = self.steps
        records.event(number, t_ns, event)
        allowed = self._safety.observe(event)
        for command in allowed:
            records.command(number, t_ns, command, "safety")
        for asked, passed in zip(outcome.commands, self._safety.judge(outcome.commands), strict=True):
            records.command(number, t_ns, asked, "kernel")
            records.command(number, t_ns, passed, "safety")
            allowed.append(passed)
        records.outcome(number, t_ns, outcome)
        if isinstance(event, Tick) and (look := records.look_if_due(t_ns)) is not None:
            records.belief(number, t_ns, look)
        return allowed

    def end(self, t_ns: int, reason: str, more: Mapping[str, Any] | None = None) -> None:
        """Write how it went, with the digests that a replay must reproduce, and what else is to be remembered."""
        self._records.end(self.steps, t_ns)
        self._writer.result(self.steps, t_ns, {**self._result(reason), **(more or {})})

    def _result(self, reason: str) -> dict[str, Any]:
        kernel = self._kernel
        return {
            "end_reason": reason,
            "belief_hash": kernel.digest(),
            "commands_hash": kernel.commands_digest(),
            "state_hash": state_digest(kernel),
            "events": self.steps,
            "detections": kernel.detections,
            "found_at_s": {str(ident): at_s for ident, at_s in kernel.found_at_s.items()},
            "interventions": self._safety.interventions,
        }
