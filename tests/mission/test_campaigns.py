"""The kill and damage campaigns, in short; `fieldkit study kills` and `fieldkit study damage` run them long."""

from collections import Counter

from sizes import size

from fieldkit.recording.records import Contents, walk
from mission.lab.campaign import damage, kills
from mission.lab.synthetic import record_simulated


def quietly(share: float, text: str) -> None:
    """Progress that nobody watches."""


def test_no_cut_and_no_flipped_bit_goes_unnoticed() -> None:
    result = damage.run(files := size(15, 60), 3, quietly)
    for row in result["scenarios"].values():
        assert row["silently_wrong"] == row["crashed"] == row["unharmed"] == 0
        assert row["warned"] + row["refused"] == files


def test_the_damage_campaign_would_notice_a_wrong_message(tmp_path) -> None:
    log = record_simulated(tmp_path, duration_s=10.0)
    other = record_simulated(tmp_path / "other", seed=2, duration_s=10.0)
    written = Counter((c.topic, m.sequence, m.log_time, m.data) for c, m in walk(log, Contents()))
    assert damage.judge(log, written) == "unharmed"
    assert damage.judge(other, written) == "silently_wrong"


def test_killed_missions_lose_under_a_second_and_nothing_is_wrong() -> None:
    (row,) = kills.run(2, 0, quietly, window_s=3.0)["scenarios"].values()
    assert row["most_lost_s"] < 1.0
    assert row["unreadable"] == row["wrong_messages"] == row["not_recovered"] == 0
    assert row["messages_kept"] > 0


def test_the_kill_campaign_would_notice_loss_and_change(tmp_path) -> None:
    log = record_simulated(tmp_path, duration_s=10.0)
    messages = [(c.topic, m.sequence, m.log_time, m.data) for c, m in walk(log, Contents())]
    rows = [f"given {topic} {number} {at} {kills._hash(data)}" for topic, number, at, data in messages]
    last_ns = max(at for topic, _, at, _ in messages if topic.startswith("/in/"))
    lost = f"given /in/tick 99 {last_ns + 1_000_000_000} 0"
    witness = tmp_path / "witness"
    witness.write_text("\n".join([*rows, lost, f"arrived {last_ns + 3_000_000_000}", ""]))
    said = kills.judge(tmp_path)
    assert said["wrong"] == 0 and said["lost_s"] == 2.0 and said["gap_s"] == 3.0
    rows[5] = rows[5][:-1] + ("0" if rows[5][-1] != "0" else "1")
    witness.write_text("\n".join([*rows, f"arrived {last_ns}", ""]))
    said = kills.judge(tmp_path)
    assert said["wrong"] == 1 and said["lost_s"] == 0.0
