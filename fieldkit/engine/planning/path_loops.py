"""The compiled loops that lay out robots' paths and value them. Their plain numpy twins are in the tests."""

import math

from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray, IntArray


@njit(cache=True, nogil=True, inline="always")
def as_far2(flat2: float, ears: FloatArray, q: int) -> float:
    """The squared distance on the sources' own ground at which the calibrated radio hears as much as robot `q`.

    `flat2` is its squared distance over ground. ears (m, 3): how high it is above the sources, by what factor its own
    threshold makes squared distances longer, and the power of d / d_over_ground by which the elevation law does.
    """
    up2 = ears[q, 0] * ears[q, 0]
    far2: float = (flat2 + up2) * ears[q, 1]
    if up2 > 0.0 and ears[q, 2] != 0.0:
        far2 *= (1.0 / max(flat2 / (flat2 + up2), 0.01)) ** ears[q, 2]
    return far2


@njit(cache=True, nogil=True)
def columns_within(
    places: FloatArray, north: float, reach: float, columns: int, cell: float
) -> tuple[int, int]:
    """From which column on, and before which, the row at `north` is within reach of one of `places` (m, 2)."""
    from_m, to_m = columns * cell, 0.0
    for q in range(places.shape[0]):
        room2 = reach * reach - (north - places[q, 1]) ** 2
        if room2 > 0.0:
            half = math.sqrt(room2)
            from_m, to_m = min(from_m, places[q, 0] - half), max(to_m, places[q, 0] + half)
    return max(0, int(math.floor(from_m / cell))), min(columns, int(math.floor(to_m / cell)) + 1)


@njit(cache=True, nogil=True)
def path_ground_gain(
    track: FloatArray,
    dt: float,
    value: FloatArray,
    cell: float,
    hear: FloatArray,
    step2: float,
    reach: float,
    rate: float,
    ears: FloatArray,
    scratch: FloatArray,
) -> float:
    """Value of the ground a group of robots would cover on its path.

    `track` (steps, m, 2); `value` (n_north, n_east) the reward of a find there times the probability that a source is
    there and that no other group will have heard it; `hear` (k,) averaged over levels; `ears` (m, 3) as of `as_far2`.
    `scratch` (as `value`) holds the path's own exposure afterwards, wherever the path is heard; elsewhere it is not
    touched.
    """
    rows, columns = value.shape
    m = track.shape[1]
    last = hear.shape[0] - 1
    per_step2 = 1.0 / step2
    alike = True  # on the ground, with calibrated radios: no reason to ask at every cell
    for q in range(m):
        alike = alike and ears[q, 0] == 0.0 and ears[q, 1] == 1.0
    # Far from the path nothing is heard: on a large field that is nearly all of it.
    low = max(0, int(math.floor((track[:, :, 1].min() - reach) / cell)))
    high = min(rows, int(math.floor((track[:, :, 1].max() + reach) / cell)) + 1)
    left = max(0, int(math.floor((track[:, :, 0].min() - reach) / cell)))
    right = min(columns, int(math.floor((track[:, :, 0].max() + reach) / cell)) + 1)
    scratch[low:high, left:right] = 0.0
    for t in range(track.shape[0]):
        row0 = max(0, int(math.floor((track[t, :, 1].min() - reach) / cell)))
        row1 = min(rows, int(math.floor((track[t, :, 1].max() + reach) / cell)) + 1)
        for r in range(row0, row1):
            north = (r + 0.5) * cell
            column0, column1 = columns_within(track[t], north, reach, columns, cell)
            for c in range(column0, column1):
                east = (c + 0.5) * cell
                silent = 1.0
                for q in range(m):
                    de = east - track[t, q, 0]
                    dn = north - track[t, q, 1]
                    d2 = de * de + dn * dn
                    if not alike:
                        d2 = as_far2(d2, ears, q)
                    k = int(d2 * per_step2)
                    if k < last:
                        silent *= 1.0 - hear[k]
                scratch[r, c] += dt * (1.0 - silent)
    gain = 0.0
    for r in range(low, high):
        for c in range(left, right):
            if scratch[r, c] > 0.0:
                gain += value[r, c] * (1.0 - math.exp(-rate * scratch[r, c]))
    return gain


@njit(cache=True, nogil=True)
def abreast(
    centre_path: FloatArray,
    start: FloatArray,
    spacing: float,
    low: FloatArray,
    high: FloatArray,
    places: FloatArray,
) -> None:
    """places (legs, m, 2) of m robots that follow `centre_path` (legs, 2) side by side from `start` (m, 2).

    Slots stand across the way to the next corner, are shifted as a whole into low..high (2,) and clipped to it;
    two robots take them the way round that is shorter for both.
    """
    legs, count = places.shape[0], places.shape[1]
    side_east, side_north = 0.0, 1.0
    before = start.copy()
    for leg in range(legs):
        centre_east, centre_north = before[:, 0].mean(), before[:, 1].mean()
        step_east = centre_path[leg, 0] - centre_east
        step_north = centre_path[leg, 1] - centre_north
        length = math.hypot(step_east, step_north)
        if length > 1e-6:
            side_east, side_north = -step_north / length, step_east / length
        for q in range(count):
            offset = (q - (count - 1) / 2.0) * spacing
            places[leg, q, 0] = centre_path[leg, 0] + offset * side_east
            places[leg, q, 1] = centre_path[leg, 1] + offset * side_north
        for axis in range(2):
            shift = max(low[axis] - places[leg, :, axis].min(), 0.0)
            shift += min(high[axis] - places[leg, :, axis].max(), 0.0)
            for q in range(count):
                places[leg, q, axis] = min(max(places[leg, q, axis] + shift, low[axis]), high[axis])
        if count == 2:
            straight = 0.0
            crossed = 0.0
            for q in range(2):
                e, n = before[q, 0], before[q, 1]
                straight += math.hypot(places[leg, q, 0] - e, places[leg, q, 1] - n)
                crossed += math.hypot(places[leg, 1 - q, 0] - e, places[leg, 1 - q, 1] - n)
            if crossed < straight:
                for axis in range(2):
                    places[leg, 0, axis], places[leg, 1, axis] = places[leg, 1, axis], places[leg, 0, axis]
        before = places[leg].copy()


@njit(cache=True, nogil=True)
def track(
    places: FloatArray,
    start: FloatArray,
    speed: float,
    turn_rad_s: float,
    step: float,
    out: FloatArray,
) -> None:
    """out (steps, m, 2): where robots are at (k + 1/2) * step on their way over places (legs, m, 2) from start (m, 2).

    Each leg takes as long as its longest way at `speed`; before it the team waits for its widest turn on the spot.
    Robots that have arrived wait at the last place.
    """
    legs, count = places.shape[0], places.shape[1]
    steps = out.shape[0]
    k = 0
    begin = 0.0
    for leg in range(legs):
        longest = 0.0
        widest = 0.0
        for q in range(count):
            e0 = start[q, 0] if leg == 0 else places[leg - 1, q, 0]
            n0 = start[q, 1] if leg == 0 else places[leg - 1, q, 1]
            de, dn = places[leg, q, 0] - e0, places[leg, q, 1] - n0
            length = math.hypot(de, dn)
            longest = max(longest, length)
            if leg > 0 and length > 1e-6:
                be = e0 - (start[q, 0] if leg == 1 else places[leg - 2, q, 0])
                bn = n0 - (start[q, 1] if leg == 1 else places[leg - 2, q, 1])
                if math.hypot(be, bn) > 1e-6:
                    turn = math.atan2(de, dn) - math.atan2(be, bn)
                    widest = max(widest, abs((turn + math.pi) % (2.0 * math.pi) - math.pi))
        turned = begin + widest / turn_rad_s
        end = turned + longest / speed
        while k < steps and ((k + 0.5) * step < end or leg == legs - 1):
            share = 1.0
            if end > turned:
                share = min(max(((k + 0.5) * step - turned) / (end - turned), 0.0), 1.0)
            for q in range(count):
                for axis in range(2):
                    a = start[q, axis] if leg == 0 else places[leg - 1, q, axis]
                    out[k, q, axis] = a + share * (places[leg, q, axis] - a)
            k += 1
        begin = end


@njit(cache=True, nogil=True)
def all_abreast(
    centre_paths: FloatArray,
    legs: IntArray,
    start: FloatArray,
    spacing: FloatArray,
    low: FloatArray,
    high: FloatArray,
    places: FloatArray,
) -> None:
    """`abreast` for each of n centre paths (n, most legs, 2) of `legs` (n,) corners, `spacing` (n,).

    places (n, most legs, m, 2); those beyond a path's legs are not touched.
    """
    for i in range(legs.shape[0]):
        abreast(centre_paths[i, : legs[i]], start, spacing[i], low, high, places[i, : legs[i]])


@njit(cache=True, nogil=True)
def all_tracks(
    places: FloatArray,
    legs: IntArray,
    start: FloatArray,
    speed: float,
    turn_rad_s: float,
    step: float,
    out: FloatArray,
) -> None:
    """out (n, steps, m, 2): `track` for each of places (n, most legs, m, 2), of `legs` (n,), each at least 1."""
    for i in range(legs.shape[0]):
        track(places[i, : legs[i]], start, speed, turn_rad_s, step, out[i])


@njit(cache=True, nogil=True)
def all_ground_gains(
    tracks: FloatArray,
    clear: FloatArray,
    dt: float,
    value: FloatArray,
    cell: float,
    hear: FloatArray,
    step2: float,
    reach: float,
    rate: float,
    ears: FloatArray,
    scratch: FloatArray,
    out: FloatArray,
) -> None:
    """out (n,): `path_ground_gain` of each of tracks (n, steps, m, 2) where `clear` (n,) is not 0; else -inf."""
    for i in range(tracks.shape[0]):
        if clear[i] == 0.0:
            out[i] = -math.inf
        else:
            out[i] = path_ground_gain(tracks[i], dt, value, cell, hear, step2, reach, rate, ears, scratch)


@njit(cache=True, nogil=True)
def all_information(
    tracks: FloatArray,
    dt: float,
    points: FloatArray,
    point_level: FloatArray,
    hear: FloatArray,
    step2: float,
    min_range: float,
    ears: FloatArray,
    out: FloatArray,
) -> None:
    """out (n, 4): `path_information` of each of tracks (n, steps, m, 2)."""
    for i in range(tracks.shape[0]):
        path_information(tracks[i], dt, points, point_level, hear, step2, min_range, ears, out[i])


@njit(cache=True, nogil=True)
def all_learnt(
    tracks: FloatArray,
    dt: float,
    points: FloatArray,
    point_level: FloatArray,
    hear: FloatArray,
    step2: float,
    min_range: float,
    ears: FloatArray,
    out: FloatArray,
) -> None:
    """What each of tracks (n, steps, m, 2) would learn of a source, were it at one of `points` (k, 2).

    out (n, k, 7), all per unit rate: expected receptions (s); of readings at distance d by P(heard), the sums of
    ee, en, nn / d^4, of e, n / d^2, and of 1, where (e, n) points from the robot to the source. `point_level` (k,) is
    an index into hear (h, steps).
    """
    last = hear.shape[1] - 1
    out[:] = 0.0
    for a in range(tracks.shape[0]):
        for i in range(points.shape[0]):
            h = int(point_level[i])
            for t in range(tracks.shape[1]):
                silent = 1.0
                for q in range(tracks.shape[2]):
                    de = points[i, 0] - tracks[a, t, q, 0]
                    dn = points[i, 1] - tracks[a, t, q, 1]
                    d2 = de * de + dn * dn
                    k = int(as_far2(d2, ears, q) / step2)
                    if k < last:
                        p = hear[h, k]
                        silent *= 1.0 - p
                        d2 = max(d2 + ears[q, 0] * ears[q, 0], min_range * min_range)
                        w = dt * p / (d2 * d2)
                        out[a, i, 1] += w * de * de
                        out[a, i, 2] += w * de * dn
                        out[a, i, 3] += w * dn * dn
                        out[a, i, 4] += dt * p * de / d2
                        out[a, i, 5] += dt * p * dn / d2
                        out[a, i, 6] += dt * p
                out[a, i, 0] += dt * (1.0 - silent)


@njit(cache=True, nogil=True)
def all_clear(tracks: FloatArray, others: FloatArray, separation: float, out: FloatArray) -> None:
    """out (n,): 1 where a track of (n, steps, m, 2) does not meet `others`, else 0."""
    for i in range(tracks.shape[0]):
        out[i] = 0.0 if meets(tracks[i], others, separation) else 1.0


@njit(cache=True, nogil=True)
def meets(one: FloatArray, others: FloatArray, separation: float) -> bool:
    """Whether a robot of track `one` (steps, m, 2) comes nearer to one of `others` (steps, k, 2) than `separation`.

    Two that begin nearer than that must not come nearer still. The shorter track sets how long is looked at.
    """
    steps = min(one.shape[0], others.shape[0])
    for p in range(one.shape[1]):
        for q in range(others.shape[1]):
            begin = math.hypot(one[0, p, 0] - others[0, q, 0], one[0, p, 1] - others[0, q, 1])
            least = max(min(separation, begin - 1e-6), 0.0)
            for t in range(1, steps):
                de = one[t, p, 0] - others[t, q, 0]
                dn = one[t, p, 1] - others[t, q, 1]
                if de * de + dn * dn < least * least:
                    return True
    return False


@njit(cache=True, nogil=True)
def path_information(
    track: FloatArray,
    dt: float,
    points: FloatArray,
    point_level: FloatArray,
    hear: FloatArray,
    step2: float,
    min_range: float,
    ears: FloatArray,
    out: FloatArray,
) -> None:
    """What a path would learn of one source, averaged over samples of where and how strong it may be.

    out (4,): expected receptions per unit rate (s), and the Fisher information of position per unit rate (s),
    without its factor (10 beta / (sigma ln 10))^2: ee, en, nn. `points` (k, 2), `point_level` (k,) index into hear.
    """
    last = hear.shape[1] - 1
    out[:] = 0.0
    for i in range(points.shape[0]):
        h = int(point_level[i])
        for t in range(track.shape[0]):
            silent = 1.0
            for q in range(track.shape[1]):
                de = points[i, 0] - track[t, q, 0]
                dn = points[i, 1] - track[t, q, 1]
                d2 = de * de + dn * dn
                k = int(as_far2(d2, ears, q) / step2)
                if k < last:
                    p = hear[h, k]
                    silent *= 1.0 - p
                    d2 = max(d2 + ears[q, 0] * ears[q, 0], min_range * min_range)
                    w = dt * p / (d2 * d2)
                    out[1] += w * de * de
                    out[2] += w * de * dn
                    out[3] += w * dn * dn
            out[0] += dt * (1.0 - silent)
    out /= points.shape[0]
