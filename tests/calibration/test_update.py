"""An antenna file improved by a mission's own readings: the truth stays inside, a false law is refused."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.cli import app
from calibration.dataset import Readings, from_arrays
from calibration.fit import PARAMETERS
from calibration.update import Update, update
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna, read_antenna
from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.messages import Detection, SourceEstimate
from fieldkit.recording.writer import RecordingWriter

TRUE = np.array([-62.0, 2.5, 3.0])
PLACE_DB, TIME_DB, LENGTH_M = 2.5, 1.66, 2.0
SENDER_M = np.array([20.0, 20.0])
STATED = np.diag(np.square([1.0, 0.15, 0.4]))


def walked(rng: np.random.Generator, exponent: float = 2.5, level_db: float = 0.0) -> Readings:
    """What a robot hears on its way about a field, with shadowing that has a length (drawn here, not by our world)."""
    count = int(rng.integers(60, 160))
    at = np.cumsum(rng.normal(0.0, 1.2, (count, 2)), axis=0) + SENDER_M + rng.normal(0.0, 5.0, 2)
    away = np.hypot(*(at - SENDER_M).T) + 0.2
    apart = np.linalg.norm(at[:, None] - at[None], axis=2)
    shadow = np.linalg.cholesky(PLACE_DB**2 * np.exp(-apart / LENGTH_M) + 1e-9 * np.eye(count)) @ rng.normal(
        size=count
    )
    level = TRUE[0] + level_db - 10.0 * exponent * np.log10(away) + shadow + rng.normal(0.0, TIME_DB, count)
    rss = np.where(level > -120.0, np.round(level), np.nan)
    cells = np.array([" ".join(map(str, cell)) for cell in np.floor(at / LENGTH_M).astype(int).tolist()])
    return from_arrays(away, rss, cells, tx_m=np.tile(SENDER_M, (count, 1)), rx_m=at, sha256="of the log")


def antenna_file(values: np.ndarray = TRUE) -> AntennaFile:
    spread = ChannelSpread(TIME_DB, PLACE_DB, LENGTH_M, assumed="for a test")
    law = Antenna(values[1], values[0], values[2], -120.0)
    return AntennaFile(law, covariance={"names": list(PARAMETERS), "matrix": STATED.tolist()}, spread=spread)


def tried(seed: int, exponent: float = 2.5, level_db: float | None = 0.0) -> Update:
    """A file whose law is off by what it says, and a walk."""
    rng = np.random.default_rng(seed)
    file = antenna_file(TRUE + np.sqrt(np.diag(STATED)) * rng.normal(size=3))
    return update(file, walked(rng, exponent, level_db or 0.0), level_db=level_db, old_sha256="of the file")


def test_the_truth_is_inside_the_new_intervals_and_nearer_than_before() -> None:
    done = [tried(seed) for seed in range(36)]
    files = [each.file for each in done if each.file is not None]
    assert len(files) > 24, "most walks lead far enough to say something"
    assert sum(each.state == "contradicts" for each in done) <= 1
    inside = np.array(
        [
            [
                file.intervals_95[name][0] <= true <= file.intervals_95[name][1]
                for name, true in zip(PARAMETERS, TRUE, strict=True)
            ]
            for file in files
        ]
    )
    assert (inside.mean(axis=0) > 0.86).all(), inside.mean(axis=0)
    off = np.array([file.antenna.power_at_1m_dbm for file in files]) - TRUE[0]
    assert np.sqrt(np.mean(off**2)) < 0.9 * np.sqrt(STATED[0, 0])


def test_another_law_is_contradicted_and_nothing_is_written() -> None:
    done = [tried(seed, exponent=4.2) for seed in range(20)]
    spoke = [each for each in done if each.state != "says too little"]
    assert len(spoke) > 10
    assert np.mean([each.state == "contradicts" for each in spoke]) > 0.8
    for each in spoke:
        assert (each.file is None) == (each.state == "contradicts")
        assert each.state != "contradicts" or "calibrate anew" in each.reasons[0]


def test_a_source_of_unknown_level_says_nothing_about_the_power() -> None:
    rng = np.random.default_rng(4)
    file = antenna_file()
    done = update(file, walked(rng, level_db=9.0), level_db=None, old_sha256="x")
    assert done.state == "updated" and done.file is not None
    assert done.file.antenna.power_at_1m_dbm == pytest.approx(TRUE[0])
    assert done.file.intervals_95["power_at_1m_dbm"][1] - TRUE[0] == pytest.approx(1.96, abs=0.01)
    assert "not given" in done.lines[1]
    told = update(file, walked(np.random.default_rng(4), level_db=9.0), level_db=9.0, old_sha256="x")
    assert told.file is not None and told.file.antenna.power_at_1m_dbm != TRUE[0]
    wrong = update(file, walked(np.random.default_rng(4), level_db=9.0), level_db=0.0, old_sha256="x")
    assert wrong.state == "contradicts"


def test_readings_that_stay_at_one_distance_say_too_little() -> None:
    ring = from_arrays(
        np.full(40, 5.0) + np.linspace(0, 0.4, 40),
        np.round(np.random.default_rng(1).normal(-80, 2, 40)),
        tx_m=np.zeros((40, 2)),
        rx_m=np.column_stack([np.full(40, 5.0), np.linspace(0, 0.4, 40)]),
    )
    done = update(antenna_file(), ring, level_db=0.0, old_sha256="x")
    assert done.state == "says too little" and done.file is None and done.reasons


# The command, on recordings


def record(path: Path, sources: list[SourceEstimate], seed: int = 0, names: bool = False) -> Path:
    """Two robots walk about two senders far apart; each packet is of one of them."""
    rng = np.random.default_rng(seed)
    senders = np.array([[20.0, 20.0], [120.0, 20.0]])
    with RecordingWriter(path) as writer:
        for k in range(160):
            whose = k % 2
            at = senders[whose] + rng.normal(0.0, 9.0, (2, 2))
            away = np.hypot(*(at - senders[whose]).T) + 0.3
            rss = np.round(TRUE[0] - 25.0 * np.log10(away) + rng.normal(0.0, 3.0, 2))
            heard = Detection(
                (k + 1) * 10**9, ("r1", "r2"), at, np.zeros(2), rss, np.zeros(2, dtype=bool),
                sender=f"s{whose}" if names else None,
            )  # fmt: skip
            writer.detection(k, heard.t_ns, heard)
        writer.sources(161, 200 * 10**9, sources)
    return path


def find(ident: int, east_m: float, name: str = "") -> SourceEstimate:
    return SourceEstimate(
        ident, east_m, 20.0, 0.01 * np.eye(2), 4, 20.0, 0.1, 1.0, 0.99, "found", name=name, power_db=0.0
    )


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["update", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return 2, str(result.exception)
    return result.exit_code, result.output


@pytest.fixture
def antenna(tmp_path: Path) -> Path:
    path = tmp_path / "antenna.toml"
    path.write_text(dump_antenna(antenna_file()))
    return path


def test_one_of_several_finds_improves_the_file_which_names_both_it_came_from(
    tmp_path: Path, antenna: Path
) -> None:
    log = record(tmp_path / "mission.mcap", [find(3, 20.0), find(7, 120.0)])
    code, said = run(antenna, log, "-o", tmp_path / "x.toml")
    assert code == 2 and "give --found NUMBER" in said and "3 at 20.0 20.0, 7 at 120.0 20.0" in said
    better = tmp_path / "better.toml"
    code, said = run(antenna, log, "--found", 7, "--level-db", 0, "-o", better)
    assert code == 0 and "verdict: updated" in said and "80 of 160 transmissions are of this source" in said
    file = read_antenna(better)
    step = file.data["updates"][0]
    assert step["antenna_sha256"] == hashlib.sha256(antenna.read_bytes()).hexdigest()
    assert step["sha256"] == hashlib.sha256(log.read_bytes()).hexdigest() and step["n_readings"] == 160
    width = [np.ptp(each.intervals_95["path_loss_exponent"]) for each in (file,)]
    assert width[0] < 2 * 1.96 * 0.15, "surer than the file was"
    again = tmp_path / "again.toml"
    code, _ = run(better, log, "--source", 20.0, 20.0, "--level-db", 0, "-o", again)
    assert code == 0 and len(read_antenna(again).data["updates"]) == 2


def test_senders_that_are_told_apart_by_their_names_need_no_odds(tmp_path: Path, antenna: Path) -> None:
    log = record(tmp_path / "m.mcap", [find(1, 20.0, "s0"), find(2, 21.0, "s1")], names=True)
    code, said = run(antenna, log, "--found", 1, "-o", tmp_path / "x.toml", "--json")
    assert code == 0 and json.loads(said)["note"].startswith("80 of 160")


def test_what_contradicts_ends_with_one_and_writes_nothing(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(dump_antenna(antenna_file(np.array([-62.0, 4.5, 3.0]))))
    log = record(tmp_path / "m.mcap", [find(3, 20.0), find(7, 120.0)])
    code, said = run(wrong, log, "--source", 20, 20, "--level-db", 0, "-o", tmp_path / "x.toml")
    assert code == 1 and "verdict: contradicts" in said and not (tmp_path / "x.toml").exists()


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (["--source", "20", "20", "--found", "3"], "give one of them"),
        (["--found", "9"], "found there: 3 at 20.0 20.0"),
        (["--source", "500", "500"], "none of its 160 transmissions"),
        (["--level-db", "nan"], "expected dB between"),
    ],
)
def test_what_cannot_be_is_said(tmp_path: Path, antenna: Path, more: list[str], expected: str) -> None:
    log = record(tmp_path / "m.mcap", [find(3, 20.0)])
    code, said = run(antenna, log, *more, "-o", tmp_path / "x.toml")
    assert code == 2 and expected in said and not (tmp_path / "x.toml").exists()
