"""`fieldkit study damage`: a recording cut and flipped at random, thousands of times; nothing may be silently wrong.

Every damaged copy is opened and read to its end. It is either refused by name, or warned about and every message
it gives is one that was written, or all of it is there and right. Anything else counts against it.
"""

import logging
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.errors import RecordingError
from fieldkit.recording.reader import open_recording
from fieldkit.recording.records import Contents, walk

Progress = Callable[[float, str], None]
_READER_LOG = logging.getLogger("fieldkit.recording.reader")
Written = tuple[str, int, int, bytes]
"""Topic, inbox number, log time, bytes: one message as it was written."""


def run(trials: int, seed: int, progress: Progress, *, recording: Path | None = None) -> dict[str, Any]:
    """So many random cuts and as many flips of one bit each; what came of them. All zero but `warned` and `refused`.

    Without a `recording` a small simulated one is made.
    """
    with tempfile.TemporaryDirectory() as folder, _quiet():
        whole = (recording or _sample(Path(folder))).read_bytes()
        written = _messages(_write(Path(folder) / "whole.mcap", whole))
        damaged = Path(folder) / "damaged.mcap"
        scenarios = {}
        for index, (kind, hurt) in enumerate((("cut", _cut), ("bit flipped", _flip))):
            rng = np.random.default_rng([seed, index])
            count: Counter[str] = Counter()
            for trial in range(trials):
                count[judge(_write(damaged, hurt(whole, rng)), written)] += 1
                if trial % 100 == 99:
                    progress((index + (trial + 1) / trials) / 2, f"{trial + 1} of {trials}: {kind}")
            scenarios[kind] = {
                "trials": trials,
                **{
                    word: count[word]
                    for word in ("warned", "refused", "unharmed", "silently_wrong", "crashed")
                },
            }
    return {
        "study": "damage",
        "trials": trials,
        "seed": seed,
        "bytes": len(whole),
        "messages": sum(written.values()),
        "scenarios": scenarios,
    }


@contextmanager
def _quiet() -> Iterator[None]:
    """Without a line in the log for each of thousands of damaged files."""
    level = _READER_LOG.level
    _READER_LOG.setLevel(logging.ERROR)
    try:
        yield
    finally:
        _READER_LOG.setLevel(level)


def judge(path: Path, written: Counter[Written]) -> str:
    """What reading a damaged file comes to: warned, refused, unharmed, silently_wrong or crashed."""
    try:
        recording = open_recording(path)
        list(recording.items())
        found = _messages(path)
    except RecordingError:
        return "refused"
    except Exception:  # whatever it is, it is what this looks for
        return "crashed"
    if found - written:
        return "silently_wrong"
    if recording.missing:
        return "warned"
    return "unharmed" if found == written else "silently_wrong"


def _messages(path: Path) -> Counter[Written]:
    """Every message that can be read, with how often."""
    return Counter(
        (channel.topic, message.sequence, message.log_time, message.data)
        for channel, message in walk(path, Contents())
    )


def _sample(folder: Path) -> Path:
    from mission.lab.synthetic import record_simulated

    return record_simulated(folder / "sample", seed=1, duration_s=40.0)


def _cut(whole: bytes, rng: np.random.Generator) -> bytes:
    return whole[: int(rng.integers(0, len(whole)))]


def _flip(whole: bytes, rng: np.random.Generator) -> bytes:
    hurt = bytearray(whole)
    hurt[int(rng.integers(0, len(whole)))] ^= 1 << int(rng.integers(0, 8))
    return bytes(hurt)


def _write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path
