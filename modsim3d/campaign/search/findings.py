"""What a search found: crashes, the worst scores, and the commands that make them again."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.search.folder import VALUES, searched
from modsim3d.campaign.search.trials import REFUSED, score_of
from modsim3d.campaign.work.row import CRASHED, DONE

NO_RATE = "The trials were chosen to be bad: they show that the tracker fails there, and no share of them is a rate."


@dataclass(frozen=True)
class Finding:
    """A trial in which the tracker failed, or came closest to it.

    Attributes:
        number: Number of the trial.
        value: The score; None if the run crashed.
        error: Why it crashed; None if it did not.
        traffic_seed: Seed of the scene.
        values: The values of the keys that were searched.
        again: The command line that makes the run again.
        film: The command line that films it too.
    """

    number: int
    value: float | None
    error: str | None
    traffic_seed: int
    values: dict[str, Any]
    again: str
    film: str


def findings(folder: CampaignFolder, table: pa.Table, count: int = 5) -> tuple[Finding, ...]:
    """The first crashes, and after them the worst scores, the worst one first.

    Args:
        folder: The folder of the search.
        table: Its trials.
        count: The most crashes, and the most scores.
    """
    search = searched(folder)
    score, order = score_of(search), "ascending" if search.minimise is not None else "descending"
    crashed = table.filter(pc.equal(table["status"], CRASHED)).slice(0, count)
    scored = _scored(table, score).sort_by([(score, order), ("run", "ascending")]).slice(0, count)
    columns = ["run", "traffic_seed", VALUES, "status", "error", score]
    rows = [row for part in (crashed, scored) for row in part.select(columns).to_pylist()]
    return tuple(_finding(folder, row, score) for row in rows)


def sentence(folder: CampaignFolder, table: pa.Table) -> str:
    """What a search comes to, in two or three sentences."""
    search = searched(folder)
    score, word = score_of(search), "lowest" if search.minimise is not None else "highest"
    counts = {status: pc.sum(pc.equal(table["status"], status)).as_py() or 0 for status in (CRASHED, REFUSED)}
    worst = [each for each in findings(folder, table, 1) if each.error is None]
    found = f"{word} {score} {worst[0].value:.4g} in trial {worst[0].number}" if worst else f"no trial has a {score}"
    said = f"{len(table)} of {search.budget} trials: {found}"
    if counts[CRASHED]:
        said += f"; {counts[CRASHED]} crashed"
    if counts[REFUSED]:
        said += f"; {counts[REFUSED]} had values that the scene, the detector or the tracker refuses"
    return f"{said}. {NO_RATE}"


def _scored(table: pa.Table, score: str) -> pa.Table:
    return table.filter(pc.and_(pc.equal(table["status"], DONE), pc.is_valid(table[score])))


def _finding(folder: CampaignFolder, row: dict[str, Any], score: str) -> Finding:
    out = folder.path / "runs" / str(row["run"])
    again = f"modsim3d campaign-run {shlex.quote(str(folder.path))} {row['run']} --out {shlex.quote(str(out))}"
    values = orjson.loads(row[VALUES])
    return Finding(row["run"], row[score], row["error"], row["traffic_seed"], values, again, f"{again} --film")
