"""Association: every limit just at and just beyond, every branch both ways."""

import numpy as np
import pytest

from fieldkit.engine.association.detections import (
    CLOCK_OFF_WINDOWS,
    FLAT_ORIGINS,
    NUMBERED_REACH_NS,
    Associator,
    PoseTrack,
)
from fieldkit.messages import Detection, Pose, ReceiverState, RssReading

S = 1_000_000_000
WINDOW_NS = S // 10
LATENESS_NS = S
ROBOTS = ("a", "b", "c")


def standing(robots: tuple[str, ...] = ROBOTS, until_s: int = 30, **options: float) -> Associator:
    """They stand at (1, 10), (2, 20), ... and 5, 10, ... high, facing 30, 60, ... degrees, every half second."""
    associator = Associator(robots, **options)
    for k, robot in enumerate(robots, start=1):
        for half in range(2 * until_s + 1):
            associator.pose(Pose(half * S // 2, robot, float(k), 10.0 * k, 5.0 * k, 30.0 * k, 0.1 * k))
    return associator


def heard(associator: Associator, robot: str, t_ns: int, rss_dbm: float = -60.0, **more: object) -> None:
    associator.reading(RssReading(t_ns, robot, rss_dbm, **more))  # type: ignore[arg-type]


def closed(associator: Associator, now_ns: int = 25 * S) -> list[Detection]:
    return associator.advance(now_ns)[0]


def who(detections: list[Detection]) -> list[list[str]]:
    """Of each detection, the robots that heard it."""
    return [[r for r, h in zip(d.robots, d.heard, strict=True) if h] for d in detections]


# Poses of one robot


def line(*places: tuple[int, float, float, float], gap_ns: int = S) -> PoseTrack:
    track = PoseTrack(gap_ns)
    for t_ns, east, north, heading in places:
        track.add(Pose(t_ns, "a", east, north, heading_deg=heading))
    return track


def at(track: PoseTrack, t_ns: int) -> tuple[float, float, float] | None:
    """East, north, heading."""
    place = track.place_at(t_ns)
    return None if place is None else place[:3]


def test_a_track_without_poses_is_nowhere() -> None:
    assert at(PoseTrack(S), 0) is None


def test_a_pose_of_the_same_instant_is_dropped_and_a_nanosecond_later_kept() -> None:
    track = line((5, 1.0, 0.0, 0.0), (5, 2.0, 0.0, 0.0), (6, 3.0, 0.0, 0.0), (4, 9.0, 0.0, 0.0))
    assert track.t_ns == [5, 6]
    assert [at(track, t) for t in (5, 6)] == [(1.0, 0.0, 0.0), (3.0, 0.0, 0.0)]


def test_at_a_pose_it_is_that_pose_wherever_in_the_track() -> None:
    track = line((0, 1.0, 4.0, 10.0), (S, 2.0, 5.0, 20.0), (2 * S, 3.0, 6.0, 30.0))
    assert [at(track, k * S) for k in range(3)] == [(1.0, 4.0, 10.0), (2.0, 5.0, 20.0), (3.0, 6.0, 30.0)]


@pytest.mark.parametrize("gap_ns", [S, 4 * S])
def test_before_the_first_and_after_the_last_pose_half_a_gap_is_known(gap_ns: int) -> None:
    half = gap_ns // 2
    track = line((10 * S, 1.0, 4.0, 10.0), (10 * S + 1, 2.0, 5.0, 20.0), gap_ns=gap_ns)
    assert at(track, 10 * S - half) == (1.0, 4.0, 10.0)
    assert at(track, 10 * S - half - 1) is None
    assert at(track, 10 * S + 1 + half) == (2.0, 5.0, 20.0)
    assert at(track, 10 * S + 2 + half) is None


def test_between_poses_as_far_apart_as_the_gap_it_is_known_and_no_further() -> None:
    assert at(line((0, 0.0, 8.0, 0.0), (S, 4.0, 0.0, 0.0)), S // 4) == (1.0, 6.0, 0.0)
    assert at(line((0, 0.0, 8.0, 0.0), (S + 1, 4.0, 0.0, 0.0)), S // 4) is None


def test_between_poses_the_two_around_count_not_the_ends_of_the_track() -> None:
    track = line((0, 9.0, 9.0, 90.0), (S, 0.0, 8.0, 0.0), (2 * S, 4.0, 0.0, 0.0), (3 * S, 7.0, 7.0, 70.0))
    assert at(track, S + S // 4) == (1.0, 6.0, 0.0)


def test_height_is_interpolated_and_a_place_is_as_unsure_as_the_less_sure_pose_beside_it() -> None:
    track = PoseTrack(S)
    for t_ns, up_m, sigma_m in ((0, 8.0, 0.5), (S, 4.0, 0.1), (2 * S, 4.0, 0.2)):
        track.add(Pose(t_ns, "a", 0.0, 0.0, up_m, 0.0, sigma_m))
    found = [track.place_at(t_ns) for t_ns in (0, S // 4, S, S + S // 2, 2 * S + 1)]
    assert [place[3:] for place in found if place] == [
        (8.0, 0.5),
        (7.0, 0.5),
        (4.0, 0.1),
        (4.0, 0.2),
        (4.0, 0.2),
    ]


@pytest.mark.parametrize(
    ("first", "then", "quarter"),
    [(10.0, 50.0, 20.0), (50.0, 10.0, 40.0), (350.0, 30.0, 0.0), (30.0, 350.0, 20.0), (200.0, 100.0, 175.0)],
)
def test_headings_turn_the_short_way(first: float, then: float, quarter: float) -> None:
    found = at(line((0, 0.0, 0.0, first), (S, 0.0, 0.0, then)), S // 4)
    assert found is not None and found[2] == pytest.approx(quarter, abs=1e-9) and 0.0 <= found[2] < 360.0


def test_a_track_forgets_what_is_older_than_half_a_minute_once_it_is_long() -> None:
    track = PoseTrack(2 * S)
    for k in range(64):
        track.add(Pose(k * S, "a", float(k), float(-k)))
    assert len(track.t_ns) == 64, "not long enough to be looked at"
    track.add(Pose(64 * S, "a", 64.0, -64.0))
    assert track.t_ns == [k * S for k in range(32, 65)] and len(track.poses) == 33
    assert at(track, 31 * S - 1) is None
    assert all(at(track, k * S) == (float(k), float(-k), 0.0) for k in range(32, 65))


def test_a_track_keeps_what_is_half_a_minute_old_to_the_nanosecond() -> None:
    """65 poses, of which the 33rd is as old as given when the last one comes."""
    for age_ns, kept in ((30 * S, 65), (30 * S + 1, 33)):
        track = PoseTrack(S)
        for k in range(64):
            track.add(Pose(k, "a", 0.0, 0.0))
        track.add(Pose(32 + age_ns, "a", 0.0, 0.0))
        assert len(track.t_ns) == len(track.poses) == kept


# What is one transmission


@pytest.mark.parametrize("later", [1, -1])
@pytest.mark.parametrize(("off_ns", "groups"), [(WINDOW_NS, 1), (WINDOW_NS + 1, 2)])
def test_receptions_a_window_apart_are_one_transmission(off_ns: int, later: int, groups: int) -> None:
    associator = standing()
    heard(associator, "a", 2 * S)
    heard(associator, "b", 2 * S + later * off_ns)
    assert len(closed(associator)) == groups


def test_the_window_may_be_another() -> None:
    associator = standing(window_s=0.3)
    heard(associator, "a", 2 * S)
    heard(associator, "b", 2 * S + 3 * WINDOW_NS)
    assert who(closed(associator)) == [["a", "b"]]


@pytest.mark.parametrize("later", [1, -1])
@pytest.mark.parametrize(("off_ns", "groups"), [(NUMBERED_REACH_NS, 1), (NUMBERED_REACH_NS + 1, 2)])
def test_a_numbered_frame_reaches_half_a_second(off_ns: int, later: int, groups: int) -> None:
    associator = standing()
    heard(associator, "a", 2 * S, frame_id="1:2/7f")
    heard(associator, "b", 2 * S + later * off_ns, frame_id="1:2/7f")
    assert len(closed(associator)) == groups


def test_a_numbered_frame_joins_the_nearest_group_of_its_number() -> None:
    for places_ns, nearest in (((2 * S, 2 * S + 6 * WINDOW_NS), 1), ((2 * S + 6 * WINDOW_NS, 2 * S), 0)):
        associator = standing()
        for t_ns in places_ns:
            heard(associator, "a", t_ns, frame_id="1:2/7f")
        heard(associator, "b", 2 * S + 4 * WINDOW_NS, frame_id="1:2/7f")
        found = who(closed(associator))
        assert found[1] == ["a", "b"] and found[0] == ["a"], nearest


def test_a_robot_that_heard_the_number_already_heard_another_frame() -> None:
    associator = standing()
    heard(associator, "a", 2 * S, frame_id="1:2/7f")
    heard(associator, "a", 2 * S + 3 * WINDOW_NS, frame_id="1:2/7f")
    assert who(closed(associator)) == [["a"], ["a"]]


def test_another_number_joins_neither_by_number_nor_by_window() -> None:
    associator = standing()
    heard(associator, "a", 2 * S, frame_id="1:2/7f")
    heard(associator, "b", 2 * S + 3 * WINDOW_NS, frame_id="1:2/80")
    heard(associator, "c", 2 * S + 1, frame_id="1:2/81")
    assert who(closed(associator)) == [["a"], ["c"], ["b"]]


def test_a_reception_without_a_name_joins_a_named_one_and_the_other_way_round() -> None:
    for first, second in (("x", None), (None, "x"), ("x", "x"), (None, None)):
        associator = standing()
        heard(associator, "a", 2 * S, frame_id=first)
        heard(associator, "b", 2 * S + 1, frame_id=second)
        assert who(closed(associator)) == [["a", "b"]]


def test_a_group_is_named_by_whoever_knows_the_name() -> None:
    associator = standing()
    heard(associator, "a", 2 * S)
    heard(associator, "b", 2 * S + 1, frame_id="x")
    heard(associator, "c", 2 * S + 2, frame_id="y")
    assert who(closed(associator)) == [["a", "b"], ["c"]]


def test_the_first_group_that_fits_is_taken_and_one_that_the_robot_heard_is_passed_over() -> None:
    associator = standing()
    heard(associator, "a", 2 * S)
    heard(associator, "a", 2 * S + WINDOW_NS // 2)
    heard(associator, "b", 2 * S + WINDOW_NS // 4)
    heard(associator, "b", 2 * S + WINDOW_NS // 4 + 1)
    assert who(closed(associator)) == [["a", "b"], ["a", "b"]]


# What is taken in


@pytest.mark.parametrize(
    ("rss_dbm", "taken"), [(-150.0, True), (-150.1, False), (0.0, True), (0.1, False), (-151.0, False)]
)
def test_a_reading_lies_between_minus_150_and_0_dbm(rss_dbm: float, taken: bool) -> None:
    associator = standing()
    heard(associator, "a", 2 * S, rss_dbm)
    assert [d.rss_dbm[0] for d in closed(associator)] == ([rss_dbm] if taken else [])


def test_energy_scans_and_strangers_are_no_receptions() -> None:
    associator = standing()
    heard(associator, "a", 2 * S, via="ed")
    heard(associator, "stranger", 2 * S)
    associator.pose(Pose(40 * S, "stranger", 0.0, 0.0))
    associator.receiver(ReceiverState(2 * S, "stranger", False))
    assert closed(associator) == [] and associator.late_readings == 0


@pytest.mark.parametrize(("off_ns", "late"), [(0, 0), (-1, 1)])
def test_a_reading_is_late_before_the_time_that_is_closed(off_ns: int, late: int) -> None:
    associator = standing()
    associator.advance(10 * S)
    associator.advance(9 * S)  # what is closed stays closed
    closed_ns = 10 * S - LATENESS_NS - WINDOW_NS
    heard(associator, "a", closed_ns + off_ns)
    assert associator.late_readings == late
    assert len(closed(associator)) == 1 - late
    heard(associator, "a", 2 * S)
    assert associator.late_readings == late + 1


@pytest.mark.parametrize(("lateness_s", "window_s"), [(1.0, 0.1), (2.5, 0.3)])
def test_a_group_is_closed_when_lateness_and_window_are_over(lateness_s: float, window_s: float) -> None:
    associator = standing(lateness_s=lateness_s, window_s=window_s)
    heard(associator, "a", 5 * S)
    due_ns = 5 * S + round((lateness_s + window_s) * 1e9)
    assert closed(associator, due_ns - 1) == []
    assert who(closed(associator, due_ns)) == [["a"]]
    assert closed(associator, due_ns + S) == [], "once"


def test_detections_come_in_order_of_time() -> None:
    associator = standing()
    for t_s in (7, 3, 5):
        heard(associator, "a", t_s * S)
    assert [d.t_ns for d in closed(associator)] == [3 * S, 5 * S, 7 * S]


# Who was there


def test_a_detection_says_of_each_robot_where_it_was_and_what_it_heard() -> None:
    associator = standing()
    heard(associator, "a", 2 * S, -61.0)
    heard(associator, "c", 2 * S, -40.0, saturated=True)
    (found,) = closed(associator)
    assert found.robots == ROBOTS and found.t_ns == 2 * S
    assert found.position_m.tolist() == [[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]]
    assert found.heading_deg.tolist() == [30.0, 60.0, 90.0]
    assert found.saturated.tolist() == [False, False, True]
    assert found.up_m.tolist() == [5.0, 10.0, 15.0] and found.sigma_m.tolist() == pytest.approx(
        [0.1, 0.2, 0.3]
    )
    assert found.rss_dbm[[0, 2]].tolist() == [-61.0, -40.0] and np.isnan(found.rss_dbm[1])


def test_a_receiver_is_down_from_its_word_to_its_next() -> None:
    for t_ns, there in ((5 * S - 1, True), (5 * S, False), (8 * S - 1, False), (8 * S, True)):
        associator = standing()
        associator.receiver(ReceiverState(5 * S, "b", False))
        associator.receiver(ReceiverState(8 * S, "b", True))
        heard(associator, "a", t_ns)
        (found,) = closed(associator)
        assert ("b" in found.robots) == there


def test_what_only_a_robot_without_a_place_heard_is_nothing() -> None:
    associator = standing(("a", "b"))
    associator.robots = ("a", "b", "lost")
    associator._tracks["lost"] = PoseTrack(S)
    associator._up["lost"] = [(0, True)]
    heard(associator, "lost", 2 * S)
    assert closed(associator) == []


@pytest.mark.parametrize("later", [1, -1])
@pytest.mark.parametrize(("off_ns", "absent"), [(0, True), (1, False)])
def test_a_reception_within_three_windows_may_be_the_same_transmission(
    off_ns: int, later: int, absent: bool
) -> None:
    associator = standing()
    heard(associator, "a", 5 * S)
    heard(associator, "b", 5 * S + later * (CLOCK_OFF_WINDOWS * WINDOW_NS + off_ns))
    found = next(d for d in closed(associator) if d.t_ns == 5 * S)
    assert found.robots == (("a", "c") if absent else ROBOTS)
    assert found.position_m[-1].tolist() == [3.0, 30.0] and found.heading_deg[-1] == 90.0


@pytest.mark.parametrize(
    ("mine", "others", "absent"),
    [("x", "x", True), ("x", None, True), (None, "x", True), (None, None, True), ("x", "y", False)],
)
def test_receptions_of_different_frames_are_not_one_transmission(
    mine: str | None, others: str | None, absent: bool
) -> None:
    associator = standing()
    heard(associator, "a", 5 * S, frame_id=mine)
    heard(associator, "b", 5 * S + 2 * WINDOW_NS, frame_id=others)
    found = next(d for d in closed(associator) if d.t_ns == 5 * S)
    assert ("b" not in found.robots) == absent


@pytest.mark.parametrize("first_is_closed", [True, False])
def test_a_neighbour_counts_before_and_after_it_is_closed(first_is_closed: bool) -> None:
    """Looked at every tenth of a second, neither of two neighbours is forgotten before the other is judged."""
    associator = standing()
    late_ns = CLOCK_OFF_WINDOWS * WINDOW_NS
    heard(associator, "a" if first_is_closed else "b", 5 * S)
    heard(associator, "b" if first_is_closed else "a", 5 * S + late_ns)
    found: list[Detection] = []
    for k in range(50, 100):
        found += closed(associator, k * S // 10)
    assert [d.robots for d in found] == (
        [("a", "c"), ("b", "c")] if first_is_closed else [("b", "c"), ("a", "c")]
    )


def test_what_is_closed_is_forgotten_after_twice_the_reach() -> None:
    associator = standing()
    for k in range(100):
        heard(associator, "a", 5 * S + 2 * k * WINDOW_NS)
    now_ns = 24 * S + WINDOW_NS
    closed(associator, now_ns)
    until_ns = now_ns - LATENESS_NS - WINDOW_NS
    since_ns = until_ns - 2 * CLOCK_OFF_WINDOWS * WINDOW_NS
    kept = [group.t_ns for group in associator._closed]
    assert kept == list(range(since_ns, until_ns + 1, 2 * WINDOW_NS)), "to the nanosecond"
    assert closed(associator, 60 * S) and associator._closed == [] and associator._open == []


@pytest.mark.parametrize(
    ("frame_id", "sender"),
    [("1:2/7f", "1:2"), ("0013a2#89ab", "0013a2"), ("0013a2", "0013a2"), (None, None), ("/7f", None)],
)
def test_a_detection_names_the_address_in_its_frame(frame_id: str | None, sender: str | None) -> None:
    associator = standing()
    heard(associator, "a", 2 * S, frame_id=frame_id)
    assert [d.sender for d in closed(associator)] == [sender]


@pytest.mark.parametrize("origin", sorted(FLAT_ORIGINS))
def test_one_that_flies_is_nowhere_while_its_positions_tell_no_height(origin: str) -> None:
    associator = Associator(("a", "b"), flying=("a",))
    for half in range(60):
        for robot in ("a", "b"):
            associator.pose(Pose(half * S // 2, robot, 1.0, 2.0, 0.0, 0.0, 0.1, origin))
    heard(associator, "b", 5 * S)
    assert [d.robots for d in closed(associator)] == [("b",)] and associator.without_height == {"a": origin}
    for up_m, source in ((3.0, origin), (0.0, "mavlink")):
        associator = Associator(("a",), flying=("a",))
        associator.pose(Pose(S, "a", 1.0, 2.0, up_m, 0.0, 0.1, source))
        assert associator._tracks["a"].t_ns and not associator.without_height


# Silence


def driving(until_s: int = 30, **options: float) -> Associator:
    """One robot that drives 1 m/s east and 2 m/s north, from time 0."""
    associator = Associator(("a",), **options)
    for half in range(2 * until_s + 1):
        associator.pose(Pose(half * S // 2, "a", half / 2.0, float(half), 3.0, 40.0, 0.2))
    return associator


def test_silence_is_told_second_by_second_with_the_place_in_the_middle() -> None:
    associator = driving()
    assert associator.advance(5 * S)[1] == [], "here it begins"
    assert associator.advance(6 * S - 1)[1] == []
    (one,) = associator.advance(6 * S)[1]
    assert (one.t0_ns, one.t1_ns, one.robots) == (4 * S, 5 * S, ("a",))
    assert one.position_m.tolist() == [[4.5, 9.0]]
    assert (one.heading_deg.tolist(), one.up_m.tolist(), one.sigma_m.tolist()) == ([40.0], [3.0], [0.2])
    two, three = associator.advance(8 * S)[1]
    assert [(x.t0_ns, x.t1_ns) for x in (two, three)] == [(5 * S, 6 * S), (6 * S, 7 * S)]
    assert three.position_m.tolist() == [[6.5, 13.0]]


def test_silence_may_be_told_in_longer_steps() -> None:
    associator = driving(silence_step_s=2.0)
    associator.advance(5 * S)
    assert associator.advance(7 * S - 1)[1] == []
    (one,) = associator.advance(7 * S)[1]
    assert (one.t0_ns, one.t1_ns, one.position_m.tolist()) == (4 * S, 6 * S, [[5.0, 10.0]])


def test_silence_begins_with_the_first_pose_of_anybody() -> None:
    associator = Associator(("a", "b"))
    assert associator.advance(5 * S)[1] == associator.advance(8 * S)[1] == []
    for half in range(60):
        associator.pose(Pose(half * S // 2, "b", 0.0, 0.0))
    assert associator.advance(10 * S)[1] == [], "from here on"
    assert [s.robots for s in associator.advance(12 * S)[1]] == [("b",), ("b",)]


def test_nobody_listening_is_no_stretch_but_time_goes_on() -> None:
    associator = driving()
    associator.receiver(ReceiverState(6 * S, "a", False))
    associator.receiver(ReceiverState(8 * S, "a", True))
    associator.advance(5 * S)
    assert [x.t0_ns // S for x in associator.advance(12 * S)[1]] == [4, 5, 8, 9, 10]


def test_who_listens_in_a_stretch_is_asked_at_its_middle() -> None:
    for down_ns, listened in ((4 * S + S // 2, False), (4 * S + S // 2 + 1, True)):
        associator = driving()
        associator.receiver(ReceiverState(down_ns, "a", False))
        associator.advance(5 * S)
        assert len(associator.advance(6 * S)[1]) == listened
