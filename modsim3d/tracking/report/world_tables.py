"""Scores of tracks in the world, as sections of the page, rows for the terminal and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from modsim3d.display import counted
from modsim3d.tracking.report.numbers import UNKNOWN, number
from modsim3d.tracking.run_scores import ScoredTracks, WorldTrackScores
from modsim3d.tracking.world.encounters import MetVessel
from modsim3d.view.pages import page

WORLD_COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("RMSE, m", "rmse_m", 1),
    ("RMSE, m/s", "rmse_m_s", 2),
    ("ANEES", "anees", 2),
    ("GOSPA, m", "gospa_m", 1),
    ("followed", "followed_share", 3),
    ("ID switches", "id_switches", 0),
    ("false tracks", "false_tracks", 0),
    ("established at, m", "established_m", 0),
    ("time left, s", "time_left_s", 0),
)
WORLD_HEADER = ("tracks in the world", *(name for name, _, _ in WORLD_COLUMNS))
ENCOUNTER_HEADER = (
    *("vessel", "own ship", "kind", "closest, m", "at, s"),
    *("first seen, s", "established, s", "at distance, m", "time left, s"),
)


def world_rows(scores: ScoredTracks) -> list[tuple[str, ...]]:
    """A line for each tracker, under `WORLD_HEADER`."""
    return [
        (each.name, *(number(each.scores.flat()[key], decimals) for _, key, decimals in WORLD_COLUMNS))
        for each in scores.world
    ]


def world_rules(each: WorldTrackScores) -> str:
    """How tracks in the world were scored."""
    distance = each.scores.set_distance
    return (
        f"A track follows a vessel within {each.scores.gate_m:g} m. GOSPA: c = {distance.cutoff:g} m, "
        f"p = {distance.power:g}. Errors are averaged within each vessel, then over vessels."
    )


def encounter_rows(encounters: Sequence[MetVessel]) -> list[tuple[str, ...]]:
    """A line for each encounter, under `ENCOUNTER_HEADER`."""
    return [
        (
            *(each.vessel, each.own_ship, each.kind.replace("_", " ")),
            *(number(each.closest_m, 0), number(each.closest_s, 1)),
            *(number(each.seen_s, 1), number(each.established_s, 1)),
            *(number(each.established_m, 0), number(each.time_left_s, 1)),
        )
        for each in encounters
    ]


def world_sections(scores: ScoredTracks) -> list[str]:
    """The sections of the page; none without tracks in the world."""
    if not scores.world:
        return []
    body = [page.heading("Tracks in the world"), page.table(world_rows(scores), WORLD_HEADER)]
    body.append(page.paragraph(world_rules(scores.world[0]), "soft"))
    for each in scores.world:
        rows = encounter_rows(each.scores.encounters)
        body.append(page.paragraph(_encounters_in_words(each)))
        never = {place for place, met in enumerate(each.scores.encounters) if _is_missed(met)}
        body += [page.table(rows, ENCOUNTER_HEADER, never)] if rows else []
    return body


def _is_missed(met: MetVessel) -> bool:
    """Whether a camera saw the vessel, and no track ever followed it."""
    return met.seen_s is not None and met.established_s is None


def _encounters_in_words(each: WorldTrackScores) -> str:
    """How many vessels met own ship, and which of them the table of encounters marks."""
    met = each.scores.encounters
    if not met:
        return f"{each.name}: no vessel came nearer to own ship."
    passed = sum(one.passed for one in met)
    said = f"{each.name}: {counted(len(met), 'vessel')} came nearer to own ship, and {passed} passed her in this run."
    return f"{said} Red: a camera saw the vessel, and no track followed it." if any(map(_is_missed, met)) else said


def world_data(scores: ScoredTracks) -> list[dict[str, Any]]:
    """What `score.json` has of them."""
    return [
        {
            "name": each.name,
            "tracks": each.path,
            "gate_m": each.scores.gate_m,
            "gospa_c_m": each.scores.set_distance.cutoff,
            "gospa_p": each.scores.set_distance.power,
            **each.scores.flat(),
            "each_encounter": [asdict(met) for met in each.scores.encounters],
        }
        for each in scores.world
    ]


def world_conclusion(scores: ScoredTracks) -> str:
    """The outcome of tracks in the world, a sentence for each tracker."""
    said = []
    for each in scores.world:
        keys = each.scores.flat()
        rmse, share = keys["rmse_m"], keys["followed_share"]
        if rmse is None:
            said.append(f"{each.name} follows no vessel in the world.")
            continue
        met = keys["encounters"]
        said.append(
            f"{each.name} follows vessels in the world with an error of {rmse:.1f} m (RMSE), for "
            f"{UNKNOWN if share is None else f'{100 * share:.0f} %'} of the time that it should"
            + (f", and {keys['encounters_established']} of the {met} that met own ship." if met else ".")
        )
    return " ".join(said)
