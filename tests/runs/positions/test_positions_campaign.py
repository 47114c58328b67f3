"""The campaign of positions: its stored result is within its bounds, and a small one agrees."""

import json
from collections.abc import Iterable
from itertools import product
from typing import Any

import pytest

from benchmarks.campaigns.positions import OUT, SCENES, SEEDS, look_at, page, position_law, problems
from modsim3d.runs.locating import MAX_RANGE_ERROR


@pytest.fixture(scope="module")
def stored() -> dict[str, Any]:
    return json.loads((OUT / "positions.json").read_text(encoding="utf-8"))


def test_the_stored_result_is_complete_and_within_bounds_that_can_be_missed(stored: dict[str, Any]) -> None:
    assert problems(stored["rows"]) == [] and stored["seeds"] == SEEDS and stored["most_range_error"] == MAX_RANGE_ERROR
    seen = {(row["scene"], row["sea"], row["attitude"], row["errors"]) for row in stored["rows"]}
    assert {name for name, *_ in seen} == set(SCENES) and len(SCENES) == 5
    for name in SCENES:
        attitudes = {attitude for scene, _, attitude, _ in seen if scene == name}
        assert attitudes in ({"ashore"}, {"true", "measured"})
        assert set(product([name], ("flat", "curved"), attitudes, (1.0, 0.2))) <= seen
    assert (OUT / "positions.md").read_text(encoding="utf-8") == page(stored)
    row = stored["rows"][0]
    for change in ({"mean": 0.3}, {"std": 1.2}, {"inside": 0.9}):
        assert len(problems([row | {"bearing": row["bearing"] | change}])) == 1
    assert len(problems([row | {"given": 5000, "inside_given": 0.9}])) == 1
    # Where no position is given it would be wrong, as in Simulation 1 with the thesis's errors.
    (row,) = (row for row in stored["rows"] if (row["scene"], row["sea"], row["errors"]) == ("simulation_1", "flat", 1))
    assert row["given"] == 0 and row["inside_others"] < 0.92
    for name in SCENES:
        rows = [row for row in stored["rows"] if row["scene"] == name and row["given"] >= 1000]
        assert rows, name
        for row in rows:
            assert row["inside_given"] > row["inside_others"] - 0.02, (name, row["sea"], row["errors"])


def test_a_small_campaign_is_within_wider_bounds() -> None:
    row = look_at("strait", "curved", "measured", 1.0, 20, 4)
    for key in ("bearing", "inverse_range"):
        assert row[key]["n"] > 300
        assert abs(row[key]["mean"]) < 0.9 and 0.5 < row[key]["std"] < 1.5 and row[key]["inside"] > 0.85, row[key]


def test_the_law_of_the_range_is_that_of_the_page() -> None:
    """The error over its stated deviation is −z (1 + ε z): its mean is −ε."""
    for row in position_law(100_000):
        if row["share"] <= 0.15:  # beyond, some inverse ranges are negative
            assert row["mean"] == pytest.approx(-row["share"], abs=0.02) and row["short"] > 0.025 > row["far"]


@pytest.mark.parametrize(("errors", "column"), [(1.0, 1), (0.2, 2)])
def test_the_page_has_the_numbers_of_the_stored_result(stored: dict[str, Any], errors: float, column: int) -> None:
    lines = (OUT.parent / "positions.md").read_text(encoding="utf-8").splitlines()
    start = next(at for at, line in enumerate(lines) if line.startswith("| | Own detector"))
    cells = [line.split(" | ")[column].removesuffix(" |") for line in lines[start + 2 : start + 7]]
    rows = [row for row in stored["rows"] if row["errors"] == errors]
    pairs = [row[key] for row in rows for key in ("bearing", "inverse_range")]
    means, given = [pair["mean"] for pair in pairs], [row["inside_given"] for row in rows if row["given"]]
    expected = [
        _percents(row["bearing"]["inside"] for row in rows),
        _percents(row["inverse_range"]["inside"] for row in rows),
        f"{min(means):+.2f} to {max(means):+.2f}".replace("-", "−"),
        _percents(given),
        _percents(row["inside_others"] for row in rows),
    ]
    assert [cell[: len(text)] for cell, text in zip(cells, expected, strict=True)] == expected
    if errors == 1.0:
        assert {row["scene"] for row in rows if row["given"]} == {"strait"}
        offsets = {line.split(" | ")[0].strip("| "): line.split(" | ")[1] for line in lines if line.count(" | ") == 2}
        for row in (row for row in rows if row["sea"] == "flat"):
            name = row["scene"].replace("simulation_", "Simulation ")
            assert offsets[name] == f"{row['centre_beyond_foot_m']:.1f} m"


def _percents(values: Iterable[float]) -> str:
    known = sorted(100 * value for value in values)
    return f"{known[0]:.1f} to {known[-1]:.1f} %"
