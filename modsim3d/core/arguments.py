"""Texts of errors in the words of Python: they name arguments where the command line has options."""

import re
from collections.abc import Collection
from functools import cache
from pathlib import Path
from traceback import walk_tb
from types import FrameType, TracebackType

_OPTION = re.compile(r"--([a-z][a-z-]*)( (?=[A-Z]|-?\d))?")  # with the space before a number or what stands for a value


def as_raised(text: str, raised: TracebackType | None) -> str:
    """The text of an error for who caught it: with arguments of the function that was called, if who caught it is no
    part of modsim3d and the function is none of the command line."""
    inside = [frame for frame, _ in walk_tb(raised) if _in_package(frame)]
    if raised is None or _in_package(raised.tb_frame) or not inside or _in_package(inside[0], "modsim3d.cli."):
        return text
    code = inside[0].f_code
    return with_arguments(text, code.co_varnames[: code.co_argcount + code.co_kwonlyargcount])


def _in_package(frame: FrameType, package: str = "modsim3d.") -> bool:
    return str(frame.f_globals.get("__name__")).startswith(package)


def with_arguments(text: str, parameters: Collection[str] = ()) -> str:
    """The text with arguments in place of options. Commands that stand alone on an indented line, to be typed, stay."""
    if "--" not in text and "modsim3d " not in text:
        return text
    phrases, names = _table()

    def argument(found: re.Match[str]) -> str:
        candidates = names.get(found[1]) or [found[1].replace("-", "_")]
        name = next((each for each in candidates if each in parameters), candidates[0])
        return name if found[2] is None else f"{name}="

    lines = text.split("\n")
    for place, line in enumerate(lines):
        if not line.startswith("  modsim3d"):
            for pattern, phrase in phrases.items():
                line = pattern.sub(phrase, line)
            lines[place] = _OPTION.sub(argument, line)
    return "\n".join(lines)


@cache
def _table() -> tuple[dict[re.Pattern[str], str], dict[str, list[str]]]:
    """Phrases by what they replace, and the arguments that an option may be."""
    import yaml  # only where something is wrong

    table = yaml.safe_load(Path(__file__).with_name("arguments.yaml").read_text(encoding="utf-8"))
    return {re.compile(pattern): phrase for pattern, phrase in table["phrases"].items()}, table["names"]
