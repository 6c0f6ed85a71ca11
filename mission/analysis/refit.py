"""One belief over a whole campaign: what many missions heard in one field, days and teams apart, on one map.

What each mission decided is left out, and so is its planner: a belief is fed with what the world said alone, and nobody
is steered. Sessions are prepared by all workers at once; a wide ground is parted in tiles, which are theirs as well.
Each finished piece is a file in a folder: another run, or another worker, takes what is there.
"""

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fieldkit.engine.grid import Grid
from fieldkit.errors import ConfigError, DataError, FieldkitError
from fieldkit.geo import FieldFrame
from fieldkit.messages import SourceEstimate
from fieldkit.recording.reader import open_recording
from mission.analysis.pool import each_done
from mission.analysis.refit_beliefs import Believed, Believing, Taking, believe, job_of, keep, read
from mission.analysis.refit_ground import between, check_one_calibration, common_ground, joint
from mission.analysis.refit_sessions import (
    Part,
    Prepared,
    Session,
    prepare,
    sessions_of,
    span_ns,
)
from mission.analysis.refit_sessions import job_of as job_of_session
from mission.analysis.refit_tiles import Tile, longest_range_m, owned, probability_left, tiles_of
from mission.core.kernel_settings import KernelSettings
from mission.maps.present import CLAIMED, Present
from mission.replay.command import Changes, changed_mission

Progress = Callable[[float, str], None]
"""Share done, and words."""

UNDATED_NS = 946_684_800_000_000_000
"""The beginning of 2000: what was recorded before that has no date. A simulated mission begins at nought, and so does a
computer whose clock was never set. Two of them did not listen at the same time: one comes after the other."""
BETWEEN_NS = 3_600_000_000_000
"""So long after another recording one without a date is put."""


@dataclass(frozen=True, slots=True)
class Work:
    """By whom the work is done, and where its pieces are kept."""

    folder: Path | None = None
    """None: in a temporary folder, which goes with the run."""
    workers: int | None = None
    """Processes here; None: one a core."""
    dask: str | None = None
    """Address of a scheduler whose workers do the work, in a folder that all of them see."""
    tiles: tuple[int, int] | None = None
    """From west to east and from south to north; None: as many as make the least work."""


@dataclass(frozen=True, slots=True)
class Refitted:
    """What a campaign says as one."""

    frame: FieldFrame
    """Of the common grid; its origin is the south-west corner of all fields."""
    grid: Grid
    parts: tuple[Part, ...]
    sessions: int
    detections: int
    """Transmissions that were heard, each once."""
    began_ns: int
    ended_ns: int
    refused: tuple[str, ...]
    """Recordings that could not be taken in, in words."""
    tiles: tuple[Tile, ...]
    believed: tuple[Believed, ...]
    """Of each tile."""
    done_now: tuple[int, int]
    """Sessions prepared and tiles finished in this run; the others were there."""

    def sources(self) -> list[SourceEstimate]:
        """Its estimates, each source once, in metres of the common frame."""
        return owned(self.tiles, [each.sources for each in self.believed])

    @property
    def probability_left(self) -> float:
        """Probability that at least one source is not found yet."""
        return probability_left(self.tiles, [each.probability_left for each in self.believed])

    @property
    def belief_hash(self) -> str:
        """Differs where a belief differs in any bit; of several tiles it is the hash of theirs in order."""
        hashes = [each.belief_hash for each in self.believed]
        return hashes[0] if len(hashes) == 1 else hashlib.sha256("".join(hashes).encode()).hexdigest()

    def present(self) -> Present:
        """The sources of which a position is claimed, for maps."""
        claimed = tuple(source for source in self.sources() if source.state in CLAIMED)
        name = f"{len(self.parts)} recordings"
        return Present(
            name, self.frame, self.ended_ns, self.began_ns, (), claimed, (), frozenset(), frozenset()
        )


def refit(
    logs: Sequence[Path],
    changes: Changes,
    report: Progress = lambda share, words: None,
    work: Work = Work(),
) -> Refitted:
    """Feed everything that was heard in `logs` to one belief; those that cannot be read are named and left out.

    Raises `DataError` where nothing is left, where recordings were made with different calibrations, and where their
    fields do not hang together; `ConfigError` where no Dask scheduler answers.
    """
    parts, frame, ground, refused = _parts(logs, changes)
    settings = joint([each.mission for each in parts], [each.names for each in parts], ground)
    tiles = tiles_of(ground, longest_range_m(settings.engine), work.tiles)
    sessions = sessions_of(parts)
    with _folder(work) as folder:
        run = _Run(settings, tiles, sessions, folder, work, report)
        believed = run.one_belief() if len(tiles) == 1 else run.many_beliefs()
    left_out = [session[k].recording.path for session, piece in run.pieces() for k, _ in piece.refused]
    refused += [words for _, piece in run.pieces() for _, words in piece.refused]
    heard = [piece for _, piece in run.pieces() if piece.rows]
    if not heard:
        why = "; ".join(refused or ["no receiver was listening at a known position"])
        raise DataError(f"nothing in the recordings says anything of sources: {why}")
    report(1.0, f"{len(parts)} of {len(parts)} recordings")
    return Refitted(
        frame,
        ground,
        tuple(part for part in parts if part.recording.path not in left_out),
        len(heard),
        sum(piece.detections for piece in heard),
        parts[0].began_ns,
        max(piece.last_ns for piece in heard),
        tuple(refused),
        tiles,
        tuple(believed),
        run.done_now,
    )


def _parts(logs: Sequence[Path], changes: Changes) -> tuple[tuple[Part, ...], FieldFrame, Grid, list[str]]:
    """The recordings in order of time, the frame and the grid they have in common, and what could not be read."""
    opened, refused = [], []
    for log in logs:
        try:
            recording = open_recording(log)
            opened.append((recording, changed_mission(recording, changes), *span_ns(recording)))
        except FieldkitError as error:
            refused.append(str(error))
    if not opened:
        raise DataError("no recording could be taken in: " + "; ".join(refused))
    opened.sort(key=lambda each: (each[2], each[0].path.name))
    missions = [each[1] for each in opened]
    check_one_calibration(missions)
    frame, ground = common_ground(missions)
    parts, free_ns = [], 0
    for number, (recording, mission, began_ns, ended_ns) in enumerate(opened, start=1):
        robots = mission.kernel.engine.robots
        names = {robot: robot if len(opened) == 1 else f"{number}.{robot}" for robot in robots}
        later_ns = max(0, free_ns - began_ns) if began_ns < UNDATED_NS else 0
        began_ns, ended_ns = began_ns + later_ns, ended_ns + later_ns
        parts.append(
            Part(recording, mission, names, *between(mission.frame, frame), began_ns, ended_ns, later_ns)
        )
        free_ns = ended_ns + BETWEEN_NS
    return tuple(parts), frame, ground, refused


@contextmanager
def _folder(work: Work) -> Iterator[Path]:
    """Where the pieces are kept."""
    if work.folder is not None:
        yield work.folder.absolute()  # a worker may stand in another folder
        return
    if work.dask:
        raise ConfigError(
            "--dask: say --work FOLDER as well, one that the workers see too: what they do goes there"
        )
    with tempfile.TemporaryDirectory(prefix="fieldkit-refit-") as made:
        yield Path(made)


class _Run:
    """What is done in one run, and what was there."""

    def __init__(
        self,
        settings: KernelSettings,
        tiles: Sequence[Tile],
        sessions: Sequence[Sequence[Part]],
        folder: Path,
        work: Work,
        report: Progress,
    ) -> None:
        self._settings, self._tiles, self._sessions = settings, tiles, sessions
        self._folder, self._work, self._report = folder, work, report
        self._pieces: dict[int, Prepared] = {}
        self.done_now = (0, 0)

    def pieces(self) -> list[tuple[Sequence[Part], Prepared]]:
        """Each session with what is known of it."""
        return [(session, self._pieces[k]) for k, session in enumerate(self._sessions)]

    def one_belief(self) -> list[Believed]:
        """Of the whole ground: it takes in each session as soon as that and all before it are prepared."""
        tile, taking = self._tiles[0], None
        jobs = [job_of_session(session, self._settings, self._folder) for session in self._sessions]
        if all(Path(job.out).exists() for job in jobs):
            self._prepare_all()
            if (finished := Path(self._job(tile).out)).exists():
                return [read(finished)]
        taking, taken = Taking(self._settings, tile, alone=True), 0
        for _ in self._preparing():
            while taken in self._pieces:
                self._say(taken, "sessions taken in")
                taking.take_in(Session.read(Path(self._pieces[taken].path)), self._names(taken))
                taken += 1
        self.done_now = (self.done_now[0], 1)
        return [keep(self._job(tile), taking.believed())]

    def many_beliefs(self) -> list[Believed]:
        """One for each tile, from all sessions."""
        self._prepare_all()
        jobs = [self._job(tile) for tile in self._tiles]
        left = [job for job in jobs if not Path(job.out).exists()]
        for done, _ in enumerate(each_done(believe, left, workers=self._work.workers, dask=self._work.dask)):
            self._report((done + 1) / len(left), f"{done + 1} of {len(left)} tiles")
        self.done_now = (self.done_now[0], len(left))
        return [read(Path(job.out)) for job in jobs]

    def _prepare_all(self) -> None:
        for done, _ in enumerate(self._preparing()):
            self._say(done, "sessions prepared")

    def _preparing(self) -> Iterator[None]:
        """Prepare the sessions that are not yet; each time one is known, it is among the pieces."""
        jobs = [job_of_session(session, self._settings, self._folder) for session in self._sessions]
        left = [k for k, job in enumerate(jobs) if k not in self._pieces and not Path(job.out).exists()]
        for k, job in enumerate(jobs):
            if k not in left:
                self._pieces[k] = self._pieces.get(k) or prepare(job)
                yield
        its = [jobs[k] for k in left]
        self.done_now = (self.done_now[0] + len(left), 0)
        for number, piece in each_done(prepare, its, workers=self._work.workers, dask=self._work.dask):
            self._pieces[left[number]] = piece
            yield

    def _say(self, done: int, words: str) -> None:
        self._report(done / len(self._sessions), f"{done} of {len(self._sessions)} {words}")

    def _names(self, session: int) -> tuple[str, ...]:
        return tuple(name for part in self._sessions[session] for name in part.names.values())

    def _job(self, tile: Tile) -> Believing:
        known = [(self._pieces[k].path, self._names(k)) for k in range(len(self._sessions))]
        return job_of(self._settings, self._tiles, tile, known, self._folder)


def plain(done: Refitted) -> dict[str, Any]:
    """Its key figures, JSON-ready; positions also as latitude and longitude."""
    from mission.replay.command import plain_source

    sources = []
    for source in done.sources():
        lat_deg, lon_deg, _ = done.frame.to_geodetic(source.east_m, source.north_m)
        sources.append(plain_source(source) | {"lat_deg": round(lat_deg, 7), "lon_deg": round(lon_deg, 7)})
    prepared, finished = done.done_now
    return {
        "recordings": len(done.parts),
        "sessions": done.sessions,
        "refused": list(done.refused),
        "missing": [f"{p.recording.path}: {p.recording.missing}" for p in done.parts if p.recording.missing],
        "origin_lat_deg": done.frame.origin_lat_deg,
        "origin_lon_deg": done.frame.origin_lon_deg,
        "size_east_m": round(done.grid.size_east_m, 2),
        "size_north_m": round(done.grid.size_north_m, 2),
        "cell_m": round(max(tile.grid.cell_m for tile in done.tiles), 3),
        "tiles": len(done.tiles),
        "tiles_nobody_was_near": sum(each.sessions == 0 for each in done.believed),
        "sessions_prepared_now": prepared,
        "tiles_finished_now": finished,
        "detections": done.detections,
        "probability_left": round(done.probability_left, 4),
        "belief_hash": done.belief_hash,
        "sources": sources,
    }
