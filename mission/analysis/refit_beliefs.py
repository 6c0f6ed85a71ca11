"""One belief over all sessions of a campaign, of the whole ground or of a tile of it, as a job that travels."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fieldkit import plugins
from fieldkit.engine.belief.base import Belief, PartingBelief, SayingBelief
from fieldkit.errors import DataError
from fieldkit.files import write_whole
from fieldkit.messages import Detection, Listening, SourceEstimate
from fieldkit.recording import codec
from mission.analysis.refit_sessions import Session, computed_by
from mission.analysis.refit_tiles import Tile, engine_of
from mission.core.kernel_settings import KernelSettings

AT_ONCE = 5
"""Transmissions taken in with one look at who sent what: as many as a live mission takes in at one tick."""
MOST_THOUGHTS = 100
"""Then the belief thinks over what it has taken in, until nothing changes or so often."""
SCHEMA = 1
"""Of the files of finished tiles; another number is computed anew."""


@dataclass(frozen=True, slots=True)
class Believing:
    """What a belief is to take in."""

    settings: KernelSettings
    """Of the whole ground, with the robots of all sessions."""
    tile: Tile
    alone: bool
    """Whether the tile is the whole ground: then it needs to know of everything."""
    sessions: tuple[str, ...]
    """Paths of prepared sessions, in order of time."""
    names: tuple[tuple[str, ...], ...]
    """Of the robots of each session, in the campaign."""
    out: str
    """Path of the file to be written."""


@dataclass(frozen=True, slots=True)
class Believed:
    """What came of it."""

    sources: tuple[SourceEstimate, ...]
    """All that the belief believes in, inside the tile and around it."""
    probability_left: float
    belief_hash: str
    said: tuple[str, ...]
    """What it had to say of receivers and of the calibration."""
    sessions: int
    """In which somebody came near it."""


class Taking:
    """A belief that is fed session by session."""

    def __init__(self, settings: KernelSettings, tile: Tile, alone: bool) -> None:
        self._tile, self._alone = tile, alone
        self._sessions = 0
        engine = engine_of(tile, settings.engine)
        self.belief: Belief = plugins.load("fieldkit.beliefs", settings.belief)(engine)

    def take_in(self, session: Session, names: Sequence[str]) -> None:
        """One session; in it robots are called `names`. Where nobody came near it is nothing."""
        if not self._alone:
            session = session.within(self._tile.heard)
        if len(session.heard) == 0:
            return
        self._sessions += 1
        if isinstance(self.belief, PartingBelief):
            self.belief.part_with_robots()
        waiting: list[Detection] = []
        for row in session.named(names):
            if isinstance(row, Listening):
                self.belief.listen(row)
                continue
            waiting.append(row)
            if len(waiting) == AT_ONCE:
                self._believe(waiting)
                waiting = []
        self._believe(waiting)
        self._think()

    def _believe(self, detections: list[Detection]) -> None:
        if detections:
            self.belief.detect_all(detections)
            self._think()

    def _think(self) -> None:
        for _ in range(MOST_THOUGHTS):
            if not self.belief.reflect():
                break

    def believed(self) -> Believed:
        """What it has come to believe."""
        said = self.belief.said() if isinstance(self.belief, SayingBelief) else []
        return Believed(
            tuple(self.belief.sources()),
            self.belief.probability_left(),
            self.belief.digest().hex(),
            tuple(said),
            self._sessions,
        )


def job_of(
    settings: KernelSettings,
    tiles: Sequence[Tile],
    tile: Tile,
    sessions: Sequence[tuple[str, tuple[str, ...]]],
    folder: Path,
) -> Believing:
    """The job of a tile: sessions as paths of what was prepared, each with its robots' names in the campaign."""
    paths, names = tuple(path for path, _ in sessions), tuple(its for _, its in sessions)
    of = [[Path(path).name, *its] for path, its in sessions]
    said = [SCHEMA, AT_ONCE, of, repr(settings), repr(tile), computed_by()]
    key = hashlib.sha256(json.dumps(said).encode()).hexdigest()[:20]
    return Believing(
        settings, tile, len(tiles) == 1, paths, names, str(folder / f"tile-{tile.number}-{key}.json")
    )


def believe(job: Believing) -> Believed:
    """Feed a tile's belief with all sessions, once: what is there already is taken as it is."""
    if Path(job.out).exists():
        return read(Path(job.out))
    taking = Taking(job.settings, job.tile, job.alone)
    for path, names in zip(job.sessions, job.names, strict=True):
        taking.take_in(Session.read(Path(path)), names)
    return keep(job, taking.believed())


def keep(job: Believing, believed: Believed) -> Believed:
    """Write what came of a job to its file; `believed`."""
    write_whole(Path(job.out), codec.encode(believed))
    return believed


def read(path: Path) -> Believed:
    """What came of a finished job. Raises `DataError` where its file does not say, saying what to do."""
    try:
        return codec.decode(Believed, path.read_bytes())
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path}: the finished tile cannot be read ({error}); delete it and run the command again"
        ) from error
