"""Where each source is by the whole log at once, with the channel as surveys have it.

`mission.analysis.refine` says which transmissions are whose. Given those, the place of each source is that of a survey
(`fieldkit.engine.location`): readings of one place share its shadowing, power and exponent are the source's own, and
where somebody listened in vain counts. What that says is as wide as the channel makes it, however many packets came.
"""

from dataclasses import replace

import numpy as np

from fieldkit.channel.antenna_file import Receiver
from fieldkit.engine.association.packets import PacketLog, Path, listened_along
from fieldkit.engine.location.ground import polygon
from fieldkit.engine.location.one_source import Radio, Silence, locate
from fieldkit.engine.location.several import Packets
from fieldkit.engine.location.survey import radio_of, with_silence
from mission.analysis.history import History
from mission.analysis.refine import Refined

MORE_LIKELY_THAN_NOT = 0.5
FEWEST_READINGS = 3
REGION = 0.9


def placed(history: History, refined: list[Refined]) -> list[Refined]:
    """The same sources with place, covariance and 90 % region of the whole log; as they are where a mission's channel
    has no place noise, or a source was hardly heard."""
    engine = history.mission.kernel.engine
    if engine.spread is None or not refined:
        return refined
    given = "power_levels_db" in history.mission.file.sources.model_fields_set
    radio = radio_of(
        engine.antenna,
        engine.spread,
        power_levels_db=engine.power_levels_db if given else (),
        source_up_m=engine.source_up_m,
        place_sigma_m=engine.pose_sigma_m,
    )
    silence = _listened(history)
    return [_placed(history, each, radio, silence) for each in refined]


def _placed(history: History, source: Refined, radio: Radio, silence: Silence) -> Refined:
    log = _packets(history, source, silence)
    if log.packets.packet.size < FEWEST_READINGS:
        return source
    located = locate(with_silence(log, np.arange(log.packets.count), radio), radio, _ground(history, radio))
    posterior = located.posterior
    east_m, north_m = posterior.centre_m()
    power_db, power_sigma_db = _power(log, radio, np.array([east_m, north_m, radio.source_up_m]))
    return replace(
        source,
        east_m=float(east_m),
        north_m=float(north_m),
        power_db=power_db,
        power_sigma_db=power_sigma_db,
        cov_m2=posterior.cov_m2,
        region=tuple(tuple(map(tuple, ring)) for ring in polygon(posterior, REGION)),
    )


def _power(log: PacketLog, radio: Radio, source_m: np.ndarray) -> tuple[float, float]:
    """How much stronger than the calibrated transmitter it is from there, by the law of the antenna file; no surer
    than one reading's place noise allows."""
    away_m = np.sqrt(((log.packets.place_m - source_m) ** 2).sum(axis=1))
    more_db = log.packets.level_db - radio.antenna.mean_rss_dbm(away_m)
    spread = radio.spread
    error_db = np.hypot(spread.sigma_place_db, spread.sigma_time_db / np.sqrt(more_db.size))
    return float(more_db.mean()), float(error_db)


def _packets(history: History, source: Refined, silence: Silence) -> PacketLog:
    """The transmissions that are rather this source's than not, less what each radio reports too much."""
    receivers = history.mission.kernel.engine.receivers
    place, level, packet = [], [], []
    chosen = [
        detection
        for (_, detection), share in zip(history.detections, source.share, strict=True)
        if share > MORE_LIKELY_THAN_NOT
    ]
    for number, detection in enumerate(chosen):
        up_m = detection.up_m if detection.up_m.size else np.zeros(len(detection.robots))
        for k in np.flatnonzero(detection.heard & ~detection.saturated).tolist():
            place.append((*detection.position_m[k], up_m[k]))
            level.append(detection.rss_dbm[k] - receivers.get(detection.robots[k], Receiver()).offset_db)
            packet.append(number)
    return PacketLog(
        Packets(
            np.array(place, dtype=float).reshape(-1, 3),
            np.array(level, dtype=float),
            np.array(packet, dtype=np.int64),
        ),
        listened=silence,
    )


def _listened(history: History) -> Silence:
    """Where robots were while their receivers were up, and for how long."""
    pieces = []
    gap_ns = round(history.mission.kernel.max_pose_gap_s * 1e9)
    for robot, track in history.tracks.items():
        up = np.ones(len(track), dtype=bool)
        for from_s, to_s in history.down(robot):
            up &= (track[:, 0] < from_s) | (track[:, 0] > to_s)
        height_m = history.mission.safety.altitude_m.get(robot, 0.0)
        place = np.column_stack([track[up, 1:3], np.full(int(up.sum()), height_m)])
        pieces.append(listened_along(Path((track[up, 0] * 1e9).astype(np.int64), place), gap_ns))
    if not pieces:
        return Silence(np.zeros((0, 3)), np.zeros(0))
    return Silence(
        np.concatenate([each.place_m for each in pieces]),
        np.concatenate([each.duration_s for each in pieces]),
    )


def _ground(history: History, radio: Radio) -> tuple[float, float, float, float]:
    """The field and one longest range beyond it: who is out there is not drawn in to the border."""
    field = history.mission.file.field
    levels_db = np.array(radio.power_levels_db or (0.0,))
    beyond_m = min(
        float(radio.antenna.nominal_range_m(levels_db).max()), max(field.size_east_m, field.size_north_m)
    )
    return (-beyond_m, -beyond_m, field.size_east_m + beyond_m, field.size_north_m + beyond_m)
