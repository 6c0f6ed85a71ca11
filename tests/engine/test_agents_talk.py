"""What robots tell each other: every log arrives whole, whatever happens to the messages, and nothing else does."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st
from sizes import size

from fieldkit.engine.decentralised import packing
from fieldkit.engine.decentralised.logs import NEVER, STEP_NS, TICK_NS, Entry, Logs, Part, Stream
from fieldkit.engine.decentralised.sealing import OVERHEAD_BYTES, Seal, parse_key, session_key
from fieldkit.engine.decentralised.talk import OPERATOR, ORDER, STATE, Talk, code_of
from fieldkit.engine.decentralised.ways import NO_WAY, Way
from fieldkit.errors import ConfigError, RecordingError
from fieldkit.messages import Operator, Pose, ReceiverState, RssReading, VehicleState
from fieldkit.world.network import Air, Network

ROBOTS = ("a", "b", "c", "d")
S = 1_000_000_000
START_NS = 1_800_000_000 * S
KEY = session_key(bytes(32), "a mission")

times = st.integers(0, 10**6).map(lambda step: START_NS + step * STEP_NS)
metres = st.floats(-1e5, 1e5)
words = st.text(max_size=20)
poses = st.builds(
    Pose, times, st.just("a"), metres, metres, metres, st.floats(0, 720), st.floats(0, 50), words
)
readings = st.builds(
    RssReading, times, st.just("a"), st.floats(-140, 0), st.sampled_from(packing.VIA),
    st.none() | st.integers(11, 26), st.none() | words, st.none() | st.integers(0, 255), st.booleans(),
    st.none() | st.floats(-120, -80),
)  # fmt: skip
states = st.builds(
    VehicleState, times, st.just("a"), st.sampled_from(packing.MODES), st.booleans(), st.booleans(),
    st.none() | st.floats(0, 100), words, st.none() | st.floats(0, 60), st.none() | st.floats(0, 9),
    st.booleans(), st.none() | st.booleans(), words,
)  # fmt: skip
orders = st.builds(
    Operator, times, st.sampled_from(packing.ACTIONS), st.none() | st.sampled_from(ROBOTS), words,
    st.none() | st.integers(0, 99), st.lists(st.tuples(metres, metres), max_size=4).map(tuple),
)  # fmt: skip
downs = st.builds(ReceiverState, times, st.just("a"), st.booleans(), words)


def member(name: str, **more: float) -> Talk:
    return Talk(Logs(name, ROBOTS), Seal(KEY, ROBOTS.index(name)), **more)


@budget(max_examples=60, deadline=None)
@given(st.lists(poses | readings | states | orders | downs, max_size=12))
def test_what_is_logged_comes_out_of_its_bytes_exactly(events: list[object]) -> None:
    mine, other = Logs("a", ROBOTS), Logs("b", ROBOTS)
    for event in events:
        exact = packing.quantised(event)  # type: ignore[arg-type]
        assert packing.quantised(exact) == exact
        mine.append(exact, START_NS + 200 * S)
    for key, entries in mine.entries.items():
        out = packing.Bytes()
        packing.pack_part(out, Part(*key, 0, tuple(entries)), ROBOTS, START_NS)
        reader = packing.Reader(bytes(out.data))
        other.take(packing.unpack_part(reader, ROBOTS, START_NS))
        assert reader.is_done
    assert other.entries == mine.entries


@pytest.mark.parametrize(
    "event",
    [
        Pose(START_NS, "a", float("nan"), 0.0),
        RssReading(START_NS, "a", float("inf")),
        VehicleState(START_NS, "a", "hold", True, battery_pct=float("nan")),
    ],
)
def test_what_is_no_number_is_not_logged(event: Pose) -> None:
    with pytest.raises(ValueError, match="number"):
        packing.quantised(event)


@budget(max_examples=200, deadline=None)
@given(st.binary(max_size=60))
def test_bytes_of_others_are_refused_and_never_an_error_of_another_kind(data: bytes) -> None:
    reader = packing.Reader(data)
    try:
        while not reader.is_done:
            packing.unpack_part(reader, ROBOTS, START_NS)
    except RecordingError:
        pass


def test_a_pose_takes_ten_bytes_and_a_reading_seven() -> None:
    every = [
        Pose(START_NS + k * TICK_NS, "a", 3.0 + 0.2 * k, 4.0 - 0.1 * k, 0.0, 20.0 + k, 0.02)
        for k in range(21)
    ]
    heard = [RssReading(START_NS + k * S, "a", -60.0 - k, "rx64") for k in range(21)]
    for events, most in ((every, 10), (heard, 7)):
        sizes = []
        for count in (1, 21):
            out = packing.Bytes()
            entries = tuple(Entry(event.t_ns, event) for event in events[:count])
            packing.pack_part(
                out,
                Part("a", Stream.PLACES if events is every else Stream.HEARD, 0, entries),
                ROBOTS,
                START_NS,
            )
            sizes.append(len(out.data))
        assert (sizes[1] - sizes[0]) / 20 <= most


# -- logs ------------------------------------------------------------------------------------------------------


def test_what_comes_late_stands_late_and_no_log_is_reopened() -> None:
    logs = Logs("a", ROBOTS)
    logs.append(RssReading(START_NS, "a", -60.0), START_NS)
    logs.close(START_NS + S)
    late = logs.append(RssReading(START_NS + S // 2, "a", -61.0), START_NS + 2 * S)
    assert late.order_ns == START_NS + S + STEP_NS and late.event.t_ns == START_NS + S // 2
    ahead = logs.append(RssReading(START_NS + 900 * S, "a", -62.0), START_NS + 2 * S)
    assert ahead.order_ns == START_NS + 2 * S, "a time in the future holds nobody up"
    logs.close(START_NS)
    assert logs.closed_of("a") == (START_NS + S) // TICK_NS, "a clock set back reopens nothing"


def test_parts_are_taken_in_any_order_and_once() -> None:
    entries = [Entry(START_NS + k * S, RssReading(START_NS + k * S, "b", -50.0 - k)) for k in range(9)]
    parts = [Part("b", Stream.HEARD, k, tuple(entries[k : k + 4])) for k in (6, 2, 4, 0, 5)]
    logs = Logs("a", ROBOTS)
    new = [entry for part in parts for entry in logs.take(part)]
    assert new == entries and logs.entries["b", Stream.HEARD] == entries
    assert logs.take(Part("z", Stream.HEARD, 0, ())) == () and logs.left_out == 1


def test_nobody_adds_to_a_time_that_its_author_has_closed() -> None:
    logs = Logs("a", ROBOTS)
    logs.learn(("b", Stream.HEARD), 0, START_NS // TICK_NS + 4)
    old = Entry(START_NS + S, RssReading(START_NS + S, "b", -50.0))
    assert logs.take(Part("b", Stream.HEARD, 0, (old,))) == () and logs.left_out == 1


def test_a_robot_takes_its_own_log_back_only_before_it_goes_on_with_it() -> None:
    entry = Entry(START_NS, RssReading(START_NS, "a", -50.0))
    part = Part("a", Stream.HEARD, 0, (entry,))
    logs = Logs("a", ROBOTS)
    assert logs.take(part) == (entry,)
    again = logs.append(RssReading(START_NS - S, "a", -51.0), START_NS + S)
    assert again.order_ns >= START_NS and logs.take(replace(part, first=2)) == ()


# -- conversation ----------------------------------------------------------------------------------------------


def converse(
    air: Air,
    seconds: int,
    seed: int,
    meanwhile: Callable[[dict[str, Talk], float], None] = lambda team, t_s: None,
    quiet_s: int = 40,
    **more: float,
) -> dict[str, Talk]:
    """Four members at the corners of a square of 10 m; each logs a pose a tick and now and then a reading.

    After `seconds` nothing new is logged, and `quiet_s` later at the latest all is told.
    """
    rng = np.random.default_rng(seed)
    team = {name: member(name, **more) for name in ROBOTS}
    places = dict(zip(ROBOTS, ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)), strict=True))
    network = Network(air, np.random.default_rng([seed, 1]))
    for tick in range(2 * (seconds + quiet_s)):
        t_s, now_ns = tick / 2, START_NS + tick * TICK_NS
        for name, data in network.arrived(t_s):
            team[name].take(data, now_ns)
        meanwhile(team, t_s)
        if t_s >= seconds and whole(team):
            break
        for name, talk in team.items():
            if t_s < seconds:
                talk.logs.append(packing.quantised(Pose(now_ns, name, float(rng.normal()), 1.0)), now_ns)
                if rng.random() < 0.3:
                    talk.logs.append(packing.quantised(RssReading(now_ns, name, -60.0)), now_ns)
            talk.logs.close(now_ns)
            for message in talk.messages(now_ns):
                network.send(t_s, name, message, places)
    return team


def whole(team: dict[str, Talk]) -> bool:
    own = {
        key: log for name, talk in team.items() for key, log in talk.logs.entries.items() if key[0] == name
    }
    return all(talk.logs.entries == own for talk in team.values())


@budget(max_examples=size(5, 10), deadline=None)
@given(
    seed=st.integers(0, 10**6),
    loss=st.sampled_from([0.0, 0.3, 0.5]),
    delay_s=st.sampled_from([0.05, 1.0, 5.0]),
    jitter_s=st.sampled_from([0.0, 2.0]),
    range_m=st.sampled_from([11.0, 100.0]),
)
def test_every_log_arrives_whole_over_any_network(
    seed: int, loss: float, delay_s: float, jitter_s: float, range_m: float
) -> None:
    """With a range of 11 m nobody hears the one across the square: what it says comes by the neighbours."""
    air = Air(range_m, loss, delay_s, jitter_s, repeated=0.2)
    team = converse(air, 35, seed, quiet_s=200)
    assert whole(team)
    assert all(not talk.logs.left_out and not talk.refused and not talk.lost for talk in team.values())


def test_what_was_missed_in_a_cut_is_caught_up_with_at_the_pace_of_the_budget() -> None:
    most: list[int] = []

    def watch(team: dict[str, Talk], t_s: float) -> None:
        sent = sum(team["a"].sent.values())
        most.append(sent)

    team = converse(Air(cut_s=(10.0, 100.0), apart=frozenset("ab")), 160, 1, watch, bytes_s=600.0)
    assert whole(team)
    a_second = [later - before for before, later in zip(most, most[2:], strict=False)]
    assert max(a_second) <= 2 * 600.0 + 600.0


def test_two_poses_and_a_reading_a_second_take_a_tenth_of_a_telemetry_radio() -> None:
    team = converse(Air(), 100, 2)
    a_second = [sum(talk.sent.values()) / 100 for talk in team.values()]
    assert max(a_second) < 200.0, "of the 1400 B/s that each of four has at 57.6 kbit/s"


def test_a_member_says_its_way_which_ways_it_knows_and_whom_it_hears() -> None:
    a, b = member("a"), member("b")
    way = Way(START_NS // TICK_NS - 3, (1.0, 2.0), (3.5, 7.25), 0.4, waits=True)
    (state,) = a.messages(START_NS, way)
    assert b.take(state, START_NS) is not None
    assert b.peers["a"].way == way and b.peers["a"].hears == () and b.peers["a"].knows == NO_WAY
    (state,) = b.messages(START_NS, None, {"a": way})
    a.take(state, START_NS)
    assert a.peers["b"].hears == ("a",) and a.peers["b"].way is None and a.peers["b"].knows == way.number
    assert b.in_range(START_NS + 2 * S) == ["a"] and b.in_range(START_NS + 4 * S) == []


def test_a_way_that_was_overtaken_by_a_later_one_is_not_believed() -> None:
    a, b = member("a"), member("b")
    first, second = (Way(START_NS // TICK_NS + k, (1.0, 2.0), (3.0 + k, 7.0), 0.4) for k in range(2))
    early, late = a.messages(START_NS, first)[0], a.messages(START_NS + TICK_NS, second)[0]
    for message in (late, early):
        assert b.take(message, START_NS + TICK_NS) is not None
    assert b.peers["a"].way == second


def test_an_order_leaves_at_once_and_is_said_again_for_those_who_missed_it() -> None:
    a, b = member("a"), member("b")
    order = Operator(START_NS, "hold", None, "stop")
    said = b.take(a.order(order, START_NS), START_NS)
    assert said is not None and said.order == order
    late = member("c").take(a.messages(START_NS + TICK_NS)[0], START_NS + TICK_NS)
    assert late is not None and late.order == order


def test_an_operator_without_a_robot_gives_orders_and_nothing_else() -> None:
    laptop = Talk(Logs("a", ROBOTS), Seal(KEY, OPERATOR))
    b = member("b")
    order = Operator(START_NS, "hold", None, "stop")
    said = b.take(laptop.say_order(order, START_NS), START_NS)
    assert said is not None and (said.robot, said.order) == ("", order)
    assert b.take(laptop.messages(START_NS)[-1], START_NS) is None and b.refused == 1 and not b.peers
    b.obeyed = code_of(order)
    laptop.take(b.messages(START_NS)[0], START_NS)
    assert laptop.peers["b"].obeyed == code_of(order) != code_of(replace(order, t_ns=START_NS + S))


def test_a_robot_whose_log_others_know_better_than_itself_is_noticed() -> None:
    a, b = member("a"), member("b")
    for k in range(3):
        a.logs.append(RssReading(START_NS + k * S, "a", -60.0), START_NS + k * S)
    a.logs.close(START_NS + 3 * S)
    for message in a.messages(START_NS + 3 * S):
        b.take(message, START_NS + 3 * S)
    forgetful = member("a")
    forgetful.logs.append(RssReading(START_NS + 4 * S, "a", -60.0), START_NS + 4 * S)
    forgetful.take(b.messages(START_NS + 4 * S)[0], START_NS + 4 * S)
    assert forgetful.lost
    patient = member("a")
    for tick in range(9):  # it listens first, and gets its log back
        now_ns = START_NS + 4 * S + tick * TICK_NS
        for message in patient.messages(now_ns):
            b.take(message, now_ns)
        for message in b.messages(now_ns):
            patient.take(message, now_ns)
    assert patient.logs.entries["a", Stream.HEARD] == a.logs.entries["a", Stream.HEARD]
    assert patient.logs.closed_of("a") == (START_NS + 3 * S) // TICK_NS and not patient.lost


# -- seals -----------------------------------------------------------------------------------------------------


@budget(max_examples=60, deadline=None)
@given(st.binary(min_size=1, max_size=80), st.data())
def test_a_message_with_one_bit_changed_is_dropped_and_counted(body: bytes, data: st.DataObject) -> None:
    sealed = bytearray(Seal(KEY, 0).write(STATE, body, START_NS))
    bit = data.draw(st.integers(0, 8 * len(sealed) - 1))
    sealed[bit // 8] ^= 1 << bit % 8
    ear = Seal(KEY, 1)
    assert ear.read(bytes(sealed), START_NS) is None and ear.dropped == {"forged": 1}


def test_messages_are_heard_once_from_members_and_not_from_long_ago() -> None:
    hand, ear = Seal(KEY, 0), Seal(KEY, 1)
    first, second = hand.write(STATE, b"1", START_NS), hand.write(ORDER, b"2", START_NS)
    for data in (second, first, first, second):
        ear.read(data, START_NS)
    assert ear.dropped == {"repeated": 2}
    stranger = Seal(session_key(bytes(32), "another mission"), 2)
    assert ear.read(stranger.write(STATE, b"", START_NS), START_NS) is None
    assert ear.read(hand.write(STATE, b"", START_NS), START_NS + 300 * S) is None
    assert hand.read(hand.write(STATE, b"", START_NS), START_NS) is None
    assert ear.dropped == {"repeated": 2, "forged": 1, "stale": 1} and hand.dropped == {"own": 1}
    assert len(first) == 1 + OVERHEAD_BYTES


def test_a_message_kept_until_its_stamp_is_forgotten_is_still_not_heard_twice() -> None:
    hand, ear = Seal(KEY, 0), Seal(KEY, 1)
    kept = hand.write(STATE, b"", START_NS)
    assert ear.read(kept, START_NS) is not None
    for number in range(600):
        assert ear.read(hand.write(STATE, b"", START_NS + number), START_NS) is not None
    assert ear.read(kept, START_NS) is None


def test_a_key_is_64_digits() -> None:
    assert parse_key("00" * 32 + "\n", "key") == bytes(32)
    for text in ("", "00", "zz" * 32):
        with pytest.raises(ConfigError, match="64 hexadecimal digits"):
            parse_key(text, "mission.key")


def test_a_tick_is_never_before_anything_is_known() -> None:
    assert Logs("a", ROBOTS).checkpoint() == NEVER
