"""The command `modsim3d campaign reproduce`: a run of a campaign again, to be looked at."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import argument, flag, option
from modsim3d.cli.terminal import open_console, say_json, timed, warn
from modsim3d.cli.terminal_tables import print_prose, print_table

if TYPE_CHECKING:
    from modsim3d.campaign.folder import CampaignFolder
    from modsim3d.campaign.keys import ScoreKeys
    from modsim3d.campaign.reproduce import ReproducedRun
    from modsim3d.tracking.worst_film import MomentFilm

NOT_THE_SAME = 1  # exit status if the run does not come out as in the campaign
HEADER = ("", "in the campaign", "again")


def campaign_reproduce_command(
    campaign: shared.CampaignArgument,
    number: Annotated[int, argument("NUMBER", "Number of the run, as in its tables.", min=0)],
    out: Annotated[Path, option("RUN", "Run directory to write; its tracks go to RUN_tracks beside it.")],
    film: Annotated[bool, flag("--film", "Film ten seconds around what went wrong in the run.")] = False,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Make a run of a campaign again, with its tracks, and compare its scores with those of the campaign.

    A run that is there already, and is this one, is not made a second time; any other is refused without --overwrite.

    Exit status 1 if it does not come out as in the campaign. A run that crashed crashes again: its error is told.

    Example: modsim3d campaign reproduce runs/example 12 --out runs/example/runs/12 --film
    """
    from modsim3d.campaign.folder import opened_campaign
    from modsim3d.campaign.reproduce import reproduce_run
    from modsim3d.campaign.work.row import CRASHED

    opened = opened_campaign(campaign)
    bar = shared.progress(f"run {number}", None)
    with shared.interruptible("; the same command goes on"), timed("run, tracks and scores"), bar as advance:
        again = reproduce_run(campaign, number, out, film=film, overwrite=overwrite, progress=advance)
    moment = again.film
    _print_run(again)
    if film and moment is None:
        calm = "nothing went wrong in this run" if "worst_s" in (again.row or {}) else "the tracks are in the world"
        warn(f"there is no film: {'the run crashed' if again.error else calm}")
    _print_outcome(opened, again, moment)
    say_json(_json(opened, again, moment))
    crashed_before = again.before is not None and again.before["status"] == CRASHED
    if not again.same or (again.error is not None and not crashed_before):
        raise typer.Exit(NOT_THE_SAME)


def _print_run(again: ReproducedRun) -> None:
    from modsim3d.campaign.plan import text_of

    run = again.run
    rows = [
        ("scene", run.condition.scene),
        *((key, text_of(value)) for key, value in run.condition.values.items()),
        ("traffic seed", str(run.traffic_seed)),
        ("detector seed", str(run.detector_seed)),
        ("tracker", run.tracker.label),
    ]
    print_table(open_console(), f"run {run.number}", rows)


def _print_outcome(campaign: CampaignFolder, again: ReproducedRun, film: MomentFilm | None) -> None:
    console, out, tracks = open_console(), shlex.quote(str(again.folder)), shlex.quote(str(again.tracks))
    if again.row is not None:
        print_table(console, "scores", _score_rows(campaign, again), header=HEADER, right=(1, 2))
    shared.print_line(console, "")
    for sentence in _sentences(again):
        print_prose(console, sentence, "bold")
    if again.error is not None:
        shared.print_line(console, f"\n{again.error}\n  {again.raised_at}")
        if (again.folder / "run.json").is_file():
            shared.print_written(console, [again.folder])
            shared.print_line(console, f"\nnext\n  modsim3d view film {out}")
        return
    for path in again.reused:
        shared.print_line(console, f"{path} was there already")
    new = [path for path in (again.folder, again.tracks) if path not in again.reused]
    shared.print_written(console, [*new, *([film.path] if film else [])])
    moment_s = (again.row or {}).get("worst_s")
    options = _score_options(campaign.keys.score)
    shared.print_line(console, f"\nnext\n  modsim3d score {out} {tracks}{options}")
    if film is None and moment_s is not None:
        shared.print_line(console, f"  modsim3d view frame {out} {moment_s}s --tracks {tracks}")
    shared.print_line(console, f"  modsim3d report {out} --tracks {tracks}")


def _sentences(again: ReproducedRun) -> list[str]:
    """Sentences on the outcome of the run."""
    lines = []
    if again.error is not None:
        crashed = again.before is not None and again.before["error"] is not None
        same = crashed and again.before is not None and again.before["error"] == again.error
        note = "with the error that the campaign has" if same else "with another error than in the campaign"
        lines.append(f"The run crashed again, {note}." if crashed else "The run crashed.")
    elif again.before is None:
        lines.append("The campaign has not done this run, so there is nothing to compare.")
    elif again.before["error"] is not None:
        lines.append(f"The run crashed in the campaign ({again.before['error']}), and did not now.")
    elif again.differing:
        lines.append(f"{len(again.differing)} columns are not as in the campaign: {', '.join(again.differing[:5])}.")
    else:
        lines.append("Every column is as in the campaign.")
    if again.versions:
        note = ", ".join(f"{name} {then or 'none'} → {now or 'none'}" for name, (then, now) in again.versions.items())
        lines.append(f"The campaign was made with other versions: {note}.")
    return lines


def _score_rows(campaign: CampaignFolder, again: ReproducedRun) -> list[tuple[str, ...]]:
    from modsim3d.campaign.verdicts.seed_values import columns_of
    from modsim3d.core.text import number
    from modsim3d.tracking.score_text import COLUMNS

    row, before = again.row or {}, again.before or {}
    forms = {key: (name, decimals) for name, key, decimals in COLUMNS}
    keys = dict.fromkeys(
        [*(column for entry in campaign.keys.require for column in columns_of(campaign.plan, entry)), *forms]
    )
    rows = [
        (forms.get(key, (key, 3))[0], *(number(side.get(key), forms.get(key, (key, 3))[1]) for side in (before, row)))
        for key in keys
    ]
    return [*rows, ("went wrong at, s", *(number(side.get("worst_s"), 2) for side in (before, row)))]


def _score_options(keys: ScoreKeys) -> str:
    """The options of `modsim3d score` that give the rules of a campaign."""
    given = keys.model_dump(exclude_defaults=True)
    names = {"truth": "vessels", "similarity": "similarity", "threshold": "threshold", "gap_s": "gap"}
    options = {option: f"{given[name]}" for name, option in names.items() if name in given}
    if keys.scale_px is not None:
        options["similarity"] = f"{keys.similarity}:{keys.scale_px}"
    if {"gospa_c", "gospa_p"} & given.keys():
        options["gospa"] = f"{keys.gospa_c}:{keys.gospa_p}"
    return "".join(f" --{option} {value}" for option, value in options.items())


def _json(campaign: CampaignFolder, again: ReproducedRun, film: MomentFilm | None) -> dict[str, Any]:
    run = again.run
    return {
        "format": 1,
        "command": "campaign reproduce",
        "campaign": campaign.path,
        "run": run.number,
        "scene": run.condition.scene,
        "values": run.condition.values,
        "traffic_seed": run.traffic_seed,
        "detector_seed": run.detector_seed,
        "tracker": run.tracker.label,
        **{name: getattr(again, name) for name in ("folder", "tracks", "same", "error")},
        "raised_at": again.raised_at or None,
        "differing": again.differing,
        "versions": again.versions,
        "row": again.row,
        "film": None if film is None else vars(film),
    }
