"""`fieldkit study` as a user meets it: files written, a second run that goes on, options it cannot take."""

import csv
import json
import subprocess
import sys
from pathlib import Path


def study(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "fieldkit", "study", *arguments], capture_output=True, text=True, check=False
    )


def test_a_study_writes_its_files_and_a_second_run_has_nothing_left_to_do(tmp_path: Path) -> None:
    asked = ("csma-fig6", "--trials", "1", "--workers", "1", "--out", str(tmp_path), "--json")
    first = study(*asked)
    assert first.returncode == 0, first.stderr
    shown = json.loads(first.stdout)
    assert "trials_table" not in shown and shown["study"] == "csma-fig6"
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["scenarios"] == shown["scenarios"]
    rows = list(csv.DictReader((tmp_path / "trials.csv").open()))
    assert len(rows) == len(result["trials_table"]) == len(shown["scenarios"])
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
    kept = (tmp_path / "trials.jsonl").read_text()
    assert len(kept.splitlines()) == len(rows)

    again = study(*asked)
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout) == shown
    assert (tmp_path / "trials.jsonl").read_text() == kept


def test_what_a_study_cannot_do_is_said_before_it_begins() -> None:
    refused = study("calibration", "--trials", "1", "--dask", "tcp://127.0.0.1:9")
    assert refused.returncode != 0
    assert "takes no --dask" in refused.stderr and "Traceback" not in refused.stderr
    unknown = study("prwa-fig99")
    assert unknown.returncode != 0
    assert "no 'prwa-fig99'" in unknown.stderr and "prwa-fig5a" in unknown.stderr
