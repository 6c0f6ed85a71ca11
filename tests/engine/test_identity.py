"""Senders told by their address: each is one source, even two in one place, and silence of frames that name nobody."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.channel.spread import assumed, known_power
from fieldkit.engine.association.detections import Associator, sender_of
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening, Pose, RssReading
from mission.lab.study.trust import antenna

RADIO = antenna()
FIELD = EngineSettings(
    Grid(12.0, 12.0, 0.5),
    RADIO,
    (("a", "b"),),
    (0.0,),
    spread=known_power(assumed(RADIO)),
    found_within_m=1.0,
    identity="address",
)
S = 1_000_000_000


def searched(
    sources: dict[str | None, tuple[float, float]], settings: EngineSettings = FIELD, rounds: int = 50
):
    belief, rng = IntensityBelief(settings), np.random.default_rng(4)
    for k in range(rounds):
        name = list(sources)[k % len(sources)]
        place = np.array(sources[name]) + rng.uniform(-2.0, 2.0, (2, 2))
        belief.listen(Listening(10 * k * S, 10 * (k + 1) * S, ("a", "b"), place))
        z = np.round(RADIO.mean_rss_dbm(np.hypot(*(place - sources[name]).T)) + rng.normal(0.0, 3.3, 2))
        z = np.where(z > RADIO.threshold_dbm, z, np.nan)
        if not np.isnan(z).all():
            belief.detect(
                Detection(10 * k * S, ("a", "b"), place, np.zeros(2), z, np.zeros(2, bool), sender=name)
            )
        belief.reflect()
    return belief


@pytest.mark.parametrize(
    ("frame_id", "sender"),
    [("1234:0001/1f", "1234:0001"), ("0013A200/89abcdef", "0013A200"), ("beacon", "beacon"), (None, None)],
)
def test_the_address_stands_before_the_number(frame_id: str | None, sender: str | None) -> None:
    assert sender_of(frame_id) == sender


def test_an_associated_packet_names_its_sender() -> None:
    associator = Associator(("a",))
    for t in (0, S // 2, S):
        associator.pose(Pose(t, "a", 1.0, 1.0))
    associator.reading(RssReading(S // 2, "a", -60.0, frame_id="1234:0001/1f"))
    (detection,), _ = associator.advance(4 * S)
    assert detection.sender == "1234:0001"


def test_two_senders_in_one_place_are_two_sources_each_with_what_it_sent() -> None:
    belief = searched({"x": (6.0, 6.0), "y": (6.2, 6.0)})
    found = {each.name: each for each in belief.sources()}
    assert set(found) == {"x", "y"} and len(belief.sources()) == 2
    for name, each in found.items():
        sent = [d for d in belief.mixture.open.values() if d.detection.sender == name]
        assert each.receptions == pytest.approx(len(sent)) and each.state == "found"
        assert np.hypot(each.east_m - 6.1, each.north_m - 6.0) < 1.0


def test_without_identity_names_change_nothing() -> None:
    anonymous = replace(FIELD, identity="anonymous")
    named = searched({"x": (6.0, 6.0)}, anonymous, 15)
    nameless = searched({None: (6.0, 6.0)}, anonymous, 15)
    assert named.digest() == nameless.digest()


def test_frames_that_name_nobody_are_said_and_told_apart_by_place() -> None:
    belief = searched({"x": (3.0, 6.0), None: (9.0, 6.0)})
    assert len([text for text in belief.said() if "name no sender" in text]) == 1
    by_name = {each.name: each for each in belief.sources() if each.receptions > 3.0}
    assert set(by_name) == {"x", ""}
    assert abs(by_name["x"].east_m - 3.0) < 1.0 and abs(by_name[""].east_m - 9.0) < 1.0
