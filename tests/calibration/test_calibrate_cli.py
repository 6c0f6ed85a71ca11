"""`fieldkit calibrate`: files are written when a calibration is accepted, and only then."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from calibration.cli import app
from fieldkit.channel.antenna_file import read_antenna
from fieldkit.errors import ConfigError, FieldkitError

EXAMPLE = Path(__file__).parents[2] / "examples" / "readings.csv"
runner = CliRunner()


def test_fit_writes_an_antenna_file_that_missions_read(tmp_path):
    out, plot, report = (tmp_path / name for name in ("antenna.toml", "fit.png", "report.html"))
    arguments = ["fit", str(EXAMPLE), "-o", str(out), "--plot", str(plot), "--report", str(report), "--json"]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    antenna = read_antenna(out)
    assert antenna.antenna.path_loss_exponent == said["path_loss_exponent"]
    assert antenna.verdict == said["verdict"] == "accepted"
    assert antenna.data["n_places"] == 40 and len(antenna.data["sha256"]) == 64
    assert plot.read_bytes().startswith(b"\x89PNG")
    page = report.read_text()
    assert "Accepted." in page and "<svg" in page
    fetched = re.findall(r"""(?:(?:src|href)\s*=\s*["']?|url\(["']?|@import\s+["']?)https?:""", page)
    assert not fetched, "names of XML vocabularies are no addresses that are asked"


@pytest.mark.parametrize(
    ("command", "phrase"),
    [
        (["fit", str(EXAMPLE)], "place to place (more readings at one place do not reduce it)"),
        (["check", "antenna.toml", "stronger.csv"], "check battery, antenna and power setting, or calibrate"),
    ],
)
def test_what_is_said_fits_in_80_columns_and_loses_no_word(command, phrase, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner.invoke(app, ["fit", str(EXAMPLE), "-o", "antenna.toml"])
    head, *rows = EXAMPLE.read_text().splitlines()
    stronger = [re.sub(r"-\d+$", lambda rss: str(int(rss[0]) + 9), row) for row in rows]
    Path("stronger.csv").write_text("\n".join([head, *stronger]))
    said = runner.invoke(app, command).output
    assert max(map(len, said.splitlines())) <= 80
    assert phrase in " ".join(said.split())


def test_a_refused_calibration_exits_with_2_and_leaves_no_file(tmp_path):
    text = "distance_m,rss_dbm\n" + "".join(f"{d / 10},{-50 - d % 4}\n" for d in range(20, 30)) * 5
    (tmp_path / "r.csv").write_text(text)
    out = tmp_path / "antenna.toml"
    result = runner.invoke(app, ["fit", str(tmp_path / "r.csv"), "-o", str(out)])
    assert result.exit_code == 2 and "refused" in result.output
    assert not out.exists()


def test_a_kept_refusal_is_marked_and_missions_refuse_it(tmp_path):
    text = "distance_m,rss_dbm\n" + "".join(f"{d / 10},{-50 - d % 4}\n" for d in range(20, 30)) * 5
    (tmp_path / "r.csv").write_text(text)
    out = tmp_path / "antenna.toml"
    assert (
        runner.invoke(app, ["fit", str(tmp_path / "r.csv"), "-o", str(out), "--keep-refused"]).exit_code == 2
    )
    assert tomllib.loads(out.read_text())["verdict"]["state"] == "refused"
    with pytest.raises(ConfigError, match="refused"):
        read_antenna(out)


def test_bad_input_is_an_error_of_ours_and_leaves_no_file(tmp_path):
    (tmp_path / "r.csv").write_text("distance_m,rss_dbm\n1,abc\n")
    out = tmp_path / "antenna.toml"
    result = runner.invoke(app, ["fit", str(tmp_path / "r.csv"), "-o", str(out)])
    assert isinstance(result.exception, FieldkitError) and result.exception.exit_code == 2
    assert not out.exists()
