"""The count of orders that lead too near another robot: what is true, and what its agent had said."""

import pytest

from fieldkit.messages import GoTo, Waypoint
from fieldkit.world.bodies import Rover
from mission.lab.too_near import TooNear

NEAR_M = 0.3


def count() -> tuple[TooNear, dict[str, Rover]]:
    return TooNear(NEAR_M), {"r1": Rover(0.0, 0.0), "r2": Rover(5.0, 0.0)}


def say(near: TooNear, rovers: dict[str, Rover], t_s: float, data: bytes, *, arrives: bool = True) -> None:
    """r2's agent says something, which r1's hears."""
    near.sent(t_s, "r2", rovers["r2"], data)
    if arrives:
        near.heard("r1", data)


def order(near: TooNear, rovers: dict[str, Rover], t_s: float, east_m: float, north_m: float) -> None:
    """r1 is sent there."""
    rovers["r1"].go_to(east_m, north_m, 0.4)
    near.ordered(GoTo(round(t_s * 1e9), "r1", Waypoint(east_m, north_m, 0.4)))
    near.look(t_s, rovers)


@pytest.mark.parametrize(("north_m", "counts"), [(0.299, 1), (-0.299, 1), (0.301, 0)])
def test_an_order_past_one_that_stands_counts_from_half_the_separation(north_m: float, counts: int) -> None:
    near, rovers = count()
    say(near, rovers, 0.0, b"1")
    rovers["r1"].north_m = north_m
    order(near, rovers, 0.5, 10.0, north_m)
    assert (near.orders, near.could_be_known) == (counts, counts)
    near.look(1.0, rovers)
    assert near.orders == counts, "an order counts once"


def test_one_that_stopped_after_its_last_word_counts_and_could_not_be_known() -> None:
    near, rovers = count()
    rovers["r2"].go_to(5.0, 9.0, 0.4)
    say(near, rovers, 0.0, b"drives")
    rovers["r2"].stop()
    say(near, rovers, 0.5, b"stands", arrives=False)
    order(near, rovers, 0.5, 10.0, 0.0)
    assert (near.orders, near.could_be_known) == (1, 0)
    (breach,) = near.breaches
    assert breach.nearest_m == 0.0 and breach.told_s == 0.5
    near.heard("r1", b"stands")
    near.heard("r1", b"drives")  # the earlier one comes late
    order(near, rovers, 1.0, 10.0, 0.0)
    assert (near.orders, near.could_be_known) == (2, 1)


def test_one_that_drives_on_as_it_said_is_where_it_should_be_by_now() -> None:
    """It goes to r1's path and stays there; when it said so it was 4 m away."""
    near, rovers = count()
    rovers["r2"].north_m = 4.0
    rovers["r2"].go_to(5.0, 0.0, 0.4)
    say(near, rovers, 0.0, b"comes")
    rovers["r2"].north_m = 2.0
    order(near, rovers, 5.0, 10.0, 0.0)
    assert (near.orders, near.could_be_known) == (1, 1)


def test_who_was_never_heard_could_not_be_known_and_two_that_part_do_not_count() -> None:
    near, rovers = count()
    order(near, rovers, 0.0, 10.0, 0.0)
    assert (near.orders, near.could_be_known) == (1, 0)
    near, rovers = count()
    rovers["r1"].east_m = 4.9
    order(near, rovers, 0.0, 0.0, 0.0)
    assert near.orders == 0
