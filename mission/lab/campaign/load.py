"""`fieldkit bench recording`: what recording costs, and how big and how quick to open its files are.

The load is a large team's: 16 robots, each with 10 readings and 10 poses a second, in virtual time, without raw bytes.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.clock import cpu_s, wall_s
from fieldkit.geo import FieldFrame
from fieldkit.messages import Event, Pose, RssReading, Tick
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter

ROBOTS = 16
RATE_HZ = 10
START_NS = 1_700_000_000_000_000_000
GRID = (50, 50)


def events(duration_s: float, rng: np.random.Generator) -> list[Event]:
    """What such a team's inbox gets: robots on their ways with GPS noise, readings in whole dBm, a tick each 0.5 s."""
    steps = round(duration_s * RATE_HZ)
    walk = np.cumsum(rng.normal(0.0, 0.03, (steps, ROBOTS, 2)), axis=0) + rng.uniform(0.0, 100.0, (ROBOTS, 2))
    noise = rng.normal(0.0, 0.02, walk.shape)
    heading = rng.uniform(0.0, 360.0, (steps, ROBOTS))
    strength = rng.normal(-75.0, 8.0, (steps, ROBOTS)).round()
    found: list[Event] = []
    for step in range(steps):
        t_ns = START_NS + step * 1_000_000_000 // RATE_HZ
        for k in range(ROBOTS):
            east, north = walk[step, k] + noise[step, k]
            jitter_ns = 1_000_003 * k
            found.append(
                Pose(t_ns + jitter_ns, f"r{k + 1}", float(east), float(north), 0.0, float(heading[step, k]))
            )
            reading = RssReading(
                t_ns + jitter_ns + 500_009,
                f"r{k + 1}",
                float(strength[step, k]),
                "rx64",
                15,
                f"0013a200:{step % 256}",
            )
            found.append(reading)
        if step % (RATE_HZ // 2) == 0:
            found.append(Tick(t_ns))
    return found


def write(path: Path, inbox: list[Event], repeats: int = 1) -> float:
    """Record the inbox, `repeats` times one after the other; CPU seconds it took."""
    rng = np.random.default_rng(3)
    span_ns = inbox[-1].t_ns - START_NS + 1_000_000_000 // RATE_HZ
    began = cpu_s()
    number = 0
    with RecordingWriter(path, frame=FieldFrame(48.0, 11.0), start_ns=START_NS) as writer:
        for repeat in range(repeats):
            for event in inbox:
                number += 1
                t_ns = event.t_ns + repeat * span_ns
                writer.event(number, t_ns, event)
                if isinstance(event, Tick) and (t_ns // 500_000_000) % 20 == 0:
                    writer.belief(number, t_ns, rng.random(GRID) * 1e-3, cell_m=0.5, digest="0" * 64)
    return cpu_s() - began


def run() -> dict[str, Any]:
    """CPU share of recording, size of two hours, and the time to open and list a file of 1 GB."""
    minutes = 5.0
    inbox = events(60.0 * minutes, np.random.default_rng(7))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "five-minutes.mcap"
        took_s = write(path, inbox)
        size = path.stat().st_size
        large = Path(folder) / "large.mcap"
        _pad(large, 1_000_000_000)
        began = wall_s()
        counts = open_recording(large).summary()["counts"]
        open_s = wall_s() - began
        return {
            "robots": ROBOTS,
            "events_per_s": len(inbox) / (60.0 * minutes),
            "share_of_one_core": took_s / (60.0 * minutes),
            "two_hours_mb": size * 120.0 / minutes / 1e6,
            "large_file_gb": large.stat().st_size / 1e9,
            "large_file_messages": sum(counts.values()),
            "open_and_list_s": open_s,
        }


def _pad(path: Path, size: int) -> None:
    """A recording of at least that size: as many raw bytes as of a camera, which do not compress."""
    rng = np.random.default_rng(1)
    with RecordingWriter(path, start_ns=START_NS) as writer:
        number = 0
        while path.stat().st_size < size:
            for _ in range(100):
                number += 1
                t_ns = START_NS + number * 10_000_000
                writer.event(number, t_ns, Tick(t_ns))
                writer.raw(t_ns, "camera", rng.bytes(20_000))


def replay_long() -> dict[str, Any]:
    """Replay of two hours of 4 simulated robots: times real time, by the wall and by the CPU, and where it goes.

    Some of it is replayed beforehand, so that compiling counts for nothing.
    """
    import cProfile
    import pstats

    from mission.lab.synthetic import record_simulated
    from mission.replay.replay import replay

    with tempfile.TemporaryDirectory() as folder:
        log = record_simulated(Path(folder), seed=3, duration_s=7200.0, sources_found=99)
        replay(log, until_s=300.0)
        began = cpu_s()
        done = replay(log)
        took_s = cpu_s() - began
        began = cpu_s()
        sum(1 for _ in open_recording(log).steps())
        reading_s = cpu_s() - began
        profile = cProfile.Profile()
        profile.runcall(replay, log, until_s=1800.0)
        spent = _cumulated(pstats.Stats(profile))
        return {
            "times_real_time": done.duration_s / done.wall_s,
            "times_real_time_by_cpu": done.duration_s / took_s,
            "events": done.events,
            "detections": done.kernel.detections,
            "size_mb": log.stat().st_size / 1e6,
            "reading_alone_s": reading_s,
            "cpu_s": took_s,
            "share_of_kernel": spent["step"] / spent["replay"],
            "share_of_safety": (spent["observe"] + spent["judge"]) / spent["replay"],
        }


def _cumulated(stats: Any) -> dict[str, float]:
    """Seconds in replay as a whole, the kernel's step, and safety, by name."""
    wanted = {"replay": "replay.py", "step": "kernel.py", "observe": "safety.py", "judge": "safety.py"}
    return {
        name: sum(
            row[3]
            for (file, _, function), row in stats.stats.items()
            if function == name and file.endswith(f"mission/{ending}")
        )
        for name, ending in wanted.items()
    }
