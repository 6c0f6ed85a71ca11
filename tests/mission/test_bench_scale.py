"""`fieldkit bench scale` in small: each of the four alone, ratios to the base's row, slopes, a plot."""

import json
from pathlib import Path

import pytest

from mission.lab import bench_scale
from mission.lab.study.results import save_bench


def test_each_row_varies_one_thing_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[tuple[int, ...]] = []

    def measured(
        *, cells: int, detections: int, robots: int, sources: int, place_noise: bool = False
    ) -> dict[str, float]:
        asked.append((cells, detections, robots, sources))
        update_ms = 0.01 * cells + 2.0 * robots
        return {
            "update_ms": update_ms,
            "plan_ms": 5.0,
            "left_ms": 1.0,
            "both_ms": update_ms + 5.0,
            "kept_mb": cells,
        }

    monkeypatch.setattr(bench_scale, "_small_field", measured)
    monkeypatch.setattr(bench_scale, "_drones", lambda **row: {"update_ms": row["cell_m"]})
    result = bench_scale.scale()
    base = (2_500, 300, 8, 8)
    assert all(sum(a != b for a, b in zip(row, base, strict=True)) <= 1 for row in asked)
    assert asked.count(base) == 2  # once for all rows, once with place noise
    cells = result["cells"]
    assert [row["cells"] for row in cells["rows"]] == [625, 2_500, 10_000, 40_000]
    assert [row["times_base"] for row in cells["rows"]][1] == 1.0
    assert cells["slope"]["kept_mb"] == pytest.approx(1.0)
    assert cells["slope"]["plan_ms"] == 0.0
    save_bench({"scale": result}, tmp_path)
    assert (
        json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["scale"]["base"]["cells"] == 2_500
    )
    assert (tmp_path / "scale.png").stat().st_size > 1_000


def test_a_row_is_measured_on_a_belief_that_has_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_scale, "LOOKS", 1)
    row = bench_scale._small_field(cells=400, detections=12, robots=2, sources=1)
    assert row["candidates"] >= 1 and row["kept_mb"] > 0.0
    assert min(row["update_ms"], row["plan_ms"], row["left_ms"]) > 0.0
    assert row["both_ms"] == pytest.approx(row["update_ms"] + row["plan_ms"], abs=0.2)
