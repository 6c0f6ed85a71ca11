"""What was searched and stayed silent: how likely a source would have been heard, wherever it might have been."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from fieldkit.channel.model import Antenna
from fieldkit.messages import FloatArray
from fieldkit.tuning import LikelihoodTuning

CELLS = 50
"""Along the longer side: finer than anybody looks."""
MOMENTS = 600
SEARCHED = 0.95
"""A place counts as searched where a source would have been heard at least once with this probability."""
OFF_FRONT_DEG = np.arange(0.0, 360.0, 10.0)


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """P(a source of the reference rate there would have been heard at least once), (n_north, n_east), row 0 south."""

    heard: FloatArray
    size_m: tuple[float, float]
    rate_hz: float

    @property
    def searched_share(self) -> float:
        """Share of the field that counts as searched."""
        return float(np.mean(self.heard >= SEARCHED))

    @property
    def searched_m2(self) -> float:
        return self.searched_share * self.size_m[0] * self.size_m[1]

    def weakest(self) -> tuple[str, float]:
        """The ninth of the field that was searched least, in words, and the mean probability there."""
        rows = [("south", 0), ("middle", 1), ("north", 2)]
        columns = [("west", 0), ("middle", 1), ("east", 2)]
        north, east = self.heard.shape
        best = ("", 2.0)
        for ns, row in rows:
            for ew, column in columns:
                part = self.heard[
                    row * north // 3 : (row + 1) * north // 3 or None,
                    column * east // 3 : (column + 1) * east // 3 or None,
                ]
                name = {("middle", "middle"): "the middle"}.get(
                    (ns, ew), "the " + "-".join(word for word in (ns, ew) if word != "middle")
                )
                if part.size and float(part.mean()) < best[1]:
                    best = (name, float(part.mean()))
        return best


def coverage(
    tracks: Mapping[str, FloatArray],
    down: Mapping[str, Sequence[tuple[float, float]]],
    antenna: Antenna,
    levels_db: Sequence[float],
    size_m: tuple[float, float],
    rate_hz: float,
    duration_s: float,
) -> Coverage:
    """From tracks, robot to (n, 3) time s, east m, north m, and the stretches (from s, to s) each receiver was down.

    The levels are taken to be equally likely; transmissions come at `rate_hz` at random.
    """
    cell_m = max(size_m) / CELLS
    n_east, n_north = (max(1, round(size / cell_m)) for size in size_m)
    east = (np.arange(n_east) + 0.5) * size_m[0] / n_east
    north = (np.arange(n_north) + 0.5) * size_m[1] / n_north
    moments = np.linspace(0.0, max(duration_s, 1e-9), min(MOMENTS, max(2, int(duration_s) + 1)))
    weight_s = duration_s / len(moments)
    exposure_s = np.zeros((len(levels_db), n_north, n_east))
    range_table = np.linspace(0.0, float(np.hypot(*size_m)) * 1.5, 2000)
    hear_table = [_p_hear(antenna, range_table, level) for level in levels_db]
    for t_s in moments:
        places = [
            place
            for robot, track in tracks.items()
            if (place := _where(track, t_s)) is not None
            and not any(a <= t_s <= b for a, b in down.get(robot, ()))
        ]
        if not places:
            continue
        distance = np.array([np.hypot(east[None, :] - e, north[:, None] - n) for e, n in places])
        for k, table in enumerate(hear_table):
            missed = np.prod(1.0 - np.interp(distance, range_table, table), axis=0)
            exposure_s[k] += weight_s * (1.0 - missed)
    return Coverage(1.0 - np.exp(-rate_hz * exposure_s).mean(axis=0), size_m, rate_hz)


def _p_hear(antenna: Antenna, range_m: FloatArray, level_db: float) -> FloatArray:
    """(k,) the probability of hearing at ranges (k,), averaged over where a directional antenna may point."""
    gain_db = np.array(
        [np.broadcast_to(antenna.gain_db(off, range_m), range_m.shape) for off in OFF_FRONT_DEG]
    )
    mean = antenna.mean_rss_dbm(range_m, level_db) + gain_db
    heard = ndtr((mean - antenna.threshold_dbm - 0.5) / antenna.sigma_db)
    return np.asarray((1.0 - LikelihoodTuning().packet_loss) * heard.mean(axis=0))


def _where(track: FloatArray, t_s: float) -> tuple[float, float] | None:
    """East and north at a moment; None before the first and after the last pose, and in gaps of over 5 s."""
    after = int(np.searchsorted(track[:, 0], t_s))
    if after == 0 or after == len(track):
        nearest = track[0 if after == 0 else -1]
        return (float(nearest[1]), float(nearest[2])) if abs(nearest[0] - t_s) <= 1.0 else None
    a, b = track[after - 1], track[after]
    if b[0] - a[0] > 5.0:
        return None
    share = (t_s - a[0]) / max(b[0] - a[0], 1e-9)
    return float(a[1] + share * (b[1] - a[1])), float(a[2] + share * (b[2] - a[2]))
