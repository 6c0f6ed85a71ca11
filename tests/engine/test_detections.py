"""Association: what counts as one transmission, who listened, and what silence covers."""

from itertools import pairwise

import numpy as np

from fieldkit.engine.association.detections import Associator, PoseTrack
from fieldkit.messages import Pose, ReceiverState, RssReading

S = 1_000_000_000


def with_poses(until_s: int = 10, **options: float) -> Associator:
    associator = Associator(("a", "b"), **options)
    for k in range(until_s * 4 + 1):
        t = k * S // 4
        associator.pose(Pose(t, "a", k / 4.0, 0.0, heading_deg=350.0 + k))
        associator.pose(Pose(t, "b", 5.0, 5.0))
    return associator


def test_receptions_within_the_window_are_one_transmission() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0))
    associator.reading(RssReading(2 * S + S // 20, "b", -70.0))
    (detection,), _ = associator.advance(9 * S)
    assert detection.robots == ("a", "b")
    assert list(detection.rss_dbm) == [-60.0, -70.0]


def test_a_robot_hears_a_transmission_once() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0))
    associator.reading(RssReading(2 * S + 1000, "a", -61.0))
    detections, _ = associator.advance(9 * S)
    assert len(detections) == 2


def test_different_frames_are_never_joined() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0, frame_id="x/1"))
    associator.reading(RssReading(2 * S + 1000, "b", -61.0, frame_id="y/7"))
    detections, _ = associator.advance(9 * S)
    assert len(detections) == 2


def test_a_numbered_frame_is_one_transmission_though_clocks_differ_by_more_than_the_window() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0, frame_id="1234:0001/7f"))
    associator.reading(RssReading(2 * S + S // 4, "b", -61.0, frame_id="1234:0001/7f"))
    (detection,), _ = associator.advance(9 * S)
    assert list(detection.rss_dbm) == [-60.0, -61.0]


def test_a_numbered_frame_goes_to_its_own_group_before_the_window_decides() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0))
    associator.reading(RssReading(2 * S + S // 20, "a", -65.0, frame_id="1234:0001/7f"))
    associator.reading(RssReading(2 * S + S // 20, "b", -61.0, frame_id="1234:0001/7f"))
    detections, _ = associator.advance(9 * S)
    assert [sorted(d.rss_dbm[~np.isnan(d.rss_dbm)]) for d in detections] == [[-60.0], [-65.0, -61.0]]


def test_an_address_without_a_number_joins_nothing_beyond_the_window() -> None:
    for frame_id in ("0013A20012345678", "0013A20012345678/89abcdef"):
        associator = with_poses()
        associator.reading(RssReading(2 * S, "a", -60.0, frame_id=frame_id))
        associator.reading(RssReading(2 * S + S // 4, "b", -61.0, frame_id=frame_id))
        detections, _ = associator.advance(9 * S)
        assert len(detections) == 2


def test_a_robot_whose_clock_may_be_off_is_absent_not_silent() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0))
    associator.reading(RssReading(2 * S + S // 5, "b", -61.0))  # twice the window later
    detections, _ = associator.advance(9 * S)
    assert [d.robots for d in detections] == [("a",), ("b",)]


def test_a_robot_that_heard_the_next_transmission_with_others_was_silent_before() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0))
    associator.reading(RssReading(2 * S + S // 5, "a", -62.0))
    associator.reading(RssReading(2 * S + S // 5, "b", -61.0))
    (first, _), _ = associator.advance(9 * S)
    assert first.robots == ("a", "b") and np.isnan(first.rss_dbm[1])


def test_a_listening_robot_that_heard_nothing_is_silent_and_one_that_was_down_is_absent() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S, "a", -60.0))
    associator.receiver(ReceiverState(4 * S, "b", up=False))
    associator.reading(RssReading(5 * S, "a", -60.0))
    (first, second), _ = associator.advance(9 * S)
    assert first.robots == ("a", "b") and np.isnan(first.rss_dbm[1])
    assert second.robots == ("a",)


def test_position_is_interpolated_to_the_reception_and_heading_across_north() -> None:
    associator = with_poses()
    associator.reading(RssReading(2 * S + S // 8, "a", -60.0))
    (detection,), _ = associator.advance(9 * S)
    assert detection.position_m[0].tolist() == [2.125, 0.0]
    track = PoseTrack(S)
    track.add(Pose(0, "a", 0, 0, heading_deg=359.0))
    track.add(Pose(S, "a", 0, 0, heading_deg=3.0))
    assert (place := track.place_at(S // 2)) is not None and abs(place[2] - 1.0) < 1e-9


def test_a_reading_without_a_pose_makes_no_detection() -> None:
    associator = Associator(("a",))
    associator.reading(RssReading(S, "a", -60.0))
    assert associator.advance(9 * S) == ([], [])


def test_a_gap_in_the_poses_makes_the_robot_absent() -> None:
    associator = Associator(("a",), max_pose_gap_s=1.0)
    associator.pose(Pose(0, "a", 0, 0))
    associator.pose(Pose(5 * S, "a", 5, 0))
    associator.reading(RssReading(2 * S, "a", -60.0))
    detections, stretches = associator.advance(9 * S)
    assert detections == []
    assert all(s.t1_ns <= S or s.t0_ns >= 4 * S for s in stretches)


def test_late_readings_are_dropped_and_counted() -> None:
    associator = with_poses()
    associator.advance(9 * S)
    associator.reading(RssReading(2 * S, "a", -60.0))
    assert associator.late_readings == 1
    assert associator.advance(10 * S)[0] == []


def test_absurd_readings_are_ignored() -> None:
    associator = with_poses()
    for rss in (np.nan, 12.0, -400.0, np.inf):
        associator.reading(RssReading(2 * S, "a", rss))
    associator.reading(RssReading(2 * S, "stranger", -60.0))
    assert associator.advance(9 * S)[0] == []


def test_poses_out_of_order_or_repeated_change_nothing() -> None:
    track = PoseTrack(S)
    for t, east in ((0, 0.0), (S, 1.0), (S // 2, 99.0), (S, 99.0)):
        track.add(Pose(t, "a", east, 0.0))
    assert (place := track.place_at(S // 2)) is not None and place[:3] == (0.5, 0.0, 0.0)


def test_listening_covers_time_once_without_gaps() -> None:
    associator = with_poses()
    stretches = []
    for second in range(3, 11):
        stretches += associator.advance(second * S)[1]
    assert all(a.t1_ns == b.t0_ns for a, b in pairwise(stretches))
    assert all(s.robots == ("a", "b") for s in stretches)
