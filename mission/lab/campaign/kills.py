"""`fieldkit study kills`: an emulated mission killed (-9) at random moments, and what its recording then lacks.

The mission runs in a process of its own on emulated radios and rovers, through the real drivers. Beside the recording
it keeps a witness, written through to the operating system at once: every event the moment it arrives, and a hash of
every message the moment it is handed to the recording. After the kill the two are compared.
"""

import hashlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.clock import wall_s, wall_sleep
from fieldkit.errors import DataError, RecordingError
from fieldkit.messages import Event
from fieldkit.recording.records import Contents, walk
from fieldkit.recording.salvage import recover
from fieldkit.recording.writer import RecordingWriter

Progress = Callable[[float, str], None]

WINDOW_S = 8.0
"""Kills are spread evenly over this long (wall time) after the first event."""
START_TIMEOUT_S = 120.0


def run(
    trials: int, seed: int, progress: Progress, *, window_s: float = WINDOW_S, rate: float = 2.0
) -> dict[str, Any]:
    """Kill so many missions; seconds lost, files that cannot be read, messages that are not what was written.

    Seconds are of mission time (`rate` of them pass in a wall second). Lost is the time from the first event that
    arrived and is not in the file to the last; the gap goes from the last one that is in the file, which may be
    longer where nothing arrived for a while.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for trial in range(trials):
        with tempfile.TemporaryDirectory() as folder:
            _kill_one(Path(folder), seed + trial, rate, float(rng.uniform(0.0, window_s)))
            rows.append(judge(Path(folder)))
        worst = max(row["lost_s"] for row in rows)
        progress((trial + 1) / trials, f"{trial + 1} of {trials} kills, at most {worst:.2f} s lost")
    lost_s = [row["lost_s"] for row in rows]
    return {
        "study": "kills",
        "trials": trials,
        "seed": seed,
        "scenarios": {
            "kill -9 of an emulated mission": {
                "most_lost_s": max(lost_s),
                "median_lost_s": float(np.median(lost_s)),
                "longest_gap_s": max(row["gap_s"] for row in rows),
                "unreadable": sum(row["unreadable"] for row in rows),
                "wrong_messages": sum(row["wrong"] for row in rows),
                "not_recovered": sum(row["not_recovered"] for row in rows),
                "messages_kept": sum(row["kept"] for row in rows),
            }
        },
    }


def judge(folder: Path) -> dict[str, Any]:
    """Compare what is left of a killed mission with its witness."""
    arrived_ns, witness = _read_witness(folder / "witness")
    found: list[tuple[str, int, int, str]] = []
    unreadable = not_recovered = False
    try:
        for channel, message in walk(folder / "mission.mcap", Contents()):
            found.append((channel.topic, message.sequence, message.log_time, _hash(message.data)))
    except RecordingError:
        unreadable = True
    try:
        recover(folder / "mission.mcap", folder / "recovered.mcap")
    except RecordingError:
        not_recovered = True
    first_lost_ns = next(
        (log_ns for topic, _, log_ns, _ in witness[len(found) :] if topic.startswith("/in/")), arrived_ns
    )
    last_kept_ns = max((log_ns for topic, _, log_ns, _ in found if topic.startswith("/in/")), default=0)
    # What was written in order must be there in order, without gaps, from the first message on.
    wrong = sum(mine != written for mine, written in zip(found, witness, strict=False))
    wrong += max(0, len(found) - len(witness))
    return {
        "lost_s": max(0.0, (arrived_ns - first_lost_ns) * 1e-9),
        "gap_s": max(0.0, (arrived_ns - last_kept_ns) * 1e-9) if last_kept_ns else 0.0,
        "unreadable": unreadable,
        "not_recovered": not_recovered,
        "wrong": wrong,
        "kept": len(found),
    }


def _read_witness(path: Path) -> tuple[int, list[tuple[str, int, int, str]]]:
    """When the last event arrived, and (topic, number, log time, hash) of everything given to the recording."""
    arrived_ns, rows = 0, []
    for line in path.read_text(encoding="ascii").split("\n")[:-1]:
        kind, *rest = line.split(" ")
        if kind == "arrived":
            arrived_ns = int(rest[0])
        else:
            rows.append((rest[0], int(rest[1]), int(rest[2]), rest[3]))
    return arrived_ns, rows


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _kill_one(folder: Path, seed: int, rate: float, after_s: float) -> None:
    """Start a mission in `folder`, and kill it so long after its first event."""
    code = (
        "import sys; from mission.lab.campaign.kills import fly; "
        "fly(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))"
    )
    command = [sys.executable, "-c", code, str(folder), str(seed), str(rate)]
    with (folder / "said").open("wb") as said:
        process = subprocess.Popen(command, stdout=said, stderr=said, start_new_session=True)
    try:
        deadline_s = wall_s() + START_TIMEOUT_S
        while not _has_begun(folder / "witness"):
            if process.poll() is not None or wall_s() > deadline_s:
                text = (folder / "said").read_text(encoding="utf-8", errors="replace")[-2000:]
                raise DataError(f"the emulated mission did not start within {START_TIMEOUT_S:.0f} s: {text}")
            wall_sleep(0.02)
        wall_sleep(after_s)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
        _end_group(process.pid)


def _has_begun(witness: Path) -> bool:
    return witness.exists() and b" /in/" in witness.read_bytes()


def _end_group(group: int) -> None:
    """The emulators the killed process had started: its own process group, nobody else's."""
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return


def fly(folder: str, seed: int, rate: float) -> None:
    """In the process that is killed: one emulated mission, with its witness."""
    import asyncio

    from mission.lab.synthetic import hidden_sources, small_mission
    from mission.shell import setups
    from mission.shell.runner import Runner
    from mission.shell.warm_up import warm_up

    mission = small_mission(Path(folder), seed=seed, duration_s=600.0, sources_found=99)
    warm_up(mission)  # as every real mission does
    witness = os.open(Path(folder) / "witness", os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    class Witnessed(RecordingWriter):
        """Writes down what it is given before it is recorded."""

        def _add(self, topic: str, data: bytes, sequence: int, log_ns: int, publish_ns: int) -> None:
            os.write(witness, f"given {topic} {sequence} {log_ns} {_hash(data)}\n".encode("ascii"))
            super()._add(topic, data, sequence, log_ns, publish_ns)

    class Watched(Runner):
        """Writes down when each event arrives."""

        def put(self, event: Event) -> None:
            super().put(event)
            os.write(witness, f"arrived {self.setup.clock.now_ns()}\n".encode("ascii"))

    with (
        setups.emulated(mission, hidden_sources(seed), seed=seed, rate=rate) as setup,
        Witnessed(
            Path(folder) / "mission.mcap",
            mission_toml=mission.text,
            antenna_toml=mission.antenna_text,
            frame=mission.frame,
            start_ns=setup.clock.now_ns(),
        ) as recorder,
    ):
        asyncio.run(Watched(mission, setup, recorder).run())
