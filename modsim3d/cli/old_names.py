"""Names of commands and options that are no more, and what each is called now."""

from collections.abc import Sequence
from difflib import get_close_matches
from itertools import takewhile
from typing import Any

from modsim3d.core.errors import ModsimError

OLD_NAMES = {
    "ais --labels": "ais --label type",
    "campaign": "campaign run CAMPAIGN",
    "campaign --like": "campaign plan CAMPAIGN --like DIR",
    "campaign --expect": "campaign plan CAMPAIGN --expect SCORE=MEAN:SPREAD",
    "campaign --plan": "campaign plan CAMPAIGN",
    "campaign --scheduler": "campaign run --cluster ADDRESS",
    "campaign --slurm": "campaign run --cluster slurm:JOBS",
    "campaign-report": "campaign report",
    "campaign-run": "campaign reproduce",
    "campaign-status": "campaign status",
    "campaign-table": "campaign table",
    "check": "check scene SCENE",
    "check --supersample": "check truth --set annotation.supersample=N",
    "compare": "check truth",
    "detect --seed": "detect --detector-seed N",
    "export --attitude": "export --true-attitude",
    "guess": "learn --detector FILE --from-condition NAME --to-condition NAME",
    "learn --bias": "",
    "learn --correct": "",
    "learn --distance": "learn --match centre:PX",
    "learn --iou": "learn --match confidence:IOU",
    "learn --page": "learn --out FILE, and the page is beside it as .html",
    "learn --run": "learn RUN...",
    "learn --scene": "learn-voyage SCENE",
    "learn --start": "learn-voyage SCENE --log-start TIME",
    "learn --state": "learn --states NAME=COND,...",
    "repeat": "check repeat",
    "report --scale": "report --similarity centre:PX",
    "rerun": "export --format rerun --out DIR",
    "run --render": "run --set annotation.render=PART",
    "score --gospa-c": "score --gospa C",
    "score --gospa-p": "score --gospa C:P",
    "score --scale": "score --similarity centre:PX",
    "score --truth": "score --vessels annotated|full",
    "verify": "check run",
    "view": "view film RUN, view frame RUN STEP, view map RUN or view sheet RUN",
    "view --at": "view map RUN STEP",
    "view --film": "view film RUN --kind KIND",
    "view --frame": "view frame RUN STEP",
    "view --from": "view film --start S",
    "view --ids": "view frame RUN STEP --kind id_buffer",
    "view --map": "view map RUN",
    "view --night": "view film --look night",
    "view --scale": "view film --similarity centre:PX",
    "view --sheet": "view sheet RUN",
    "view --to": "view film --end S",
    "view --visibility": "view film --look fog:M",
}
OF_A_VOYAGE = ("attitude", "camera", "empty", "fixed", "images", "known", "position-noise", "stale", "write-scene")
OLD_NAMES |= {f"learn --{name}": f"learn-voyage SCENE --{name}" for name in OF_A_VOYAGE}
"""What stood after `modsim3d`, and what stands there now; nothing where an option has gone."""


def refuse_old_names(context: Any, arguments: Sequence[str]) -> None:
    """Raise a `ModsimError` with the new name where one of the arguments after a command's or group's name is an old
    one. `context` is the command or group, as typer has it."""
    command, path = context.command, _path(context)
    subcommands = getattr(command, "commands", None)
    first = arguments[0] if arguments else ""
    if subcommands is not None and first in subcommands:
        return  # which looks at the rest
    known = {name for parameter in command.params for name in parameter.opts}
    options = [word.partition("=")[0] for word in takewhile(lambda word: word != "--", arguments) if word[:2] == "--"]
    asked = [f"{path[0]} {name}" for name in options if name not in known] if path else []
    if subcommands is not None and not path:
        asked.append(first)
    elif subcommands is not None and first[:1] not in ("", "-") and not get_close_matches(first, subcommands):
        asked.append(path[0])  # else typer names the one that was meant
    for old in asked:
        if old in OLD_NAMES:
            new = OLD_NAMES[old]
            raise ModsimError(f"modsim3d {old} is " + (f"now: modsim3d {new}" if new else "no more"))


def _path(context: Any) -> list[str]:
    """The words after `modsim3d` that name the command."""
    return [] if context.parent is None else [*_path(context.parent), str(context.info_name)]
