"""The command that a user typed, in a form that a page can keep."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

import typer

LEFT_OUT = frozenset({"out", "page", "overwrite", "quiet", "verbose", "json", "workers"})
"""Parameters that decide where files go or what is printed, and not what a page says."""


def typed_command(context: typer.Context) -> str:
    """The command with its arguments and the options that were given, in the order of its help.

    Options have their long names. Those that only say where files go or what is printed are left out.
    """
    words = ["modsim3d", str(context.info_name)]
    parameters = [each for each in context.command.params if each.name not in LEFT_OUT]
    for parameter in sorted(parameters, key=lambda each: each.param_type_name != "argument"):
        source = context.get_parameter_source(str(parameter.name))
        if source is not None and source.name == "COMMANDLINE":
            words += _words(parameter, context.params[str(parameter.name)])
    return shlex.join(words)


def _words(parameter: Any, value: Any) -> Iterator[str]:
    values = value if isinstance(value, list | tuple) else [value]
    if parameter.param_type_name == "argument":
        yield from map(_text, values)
        return
    name = max(parameter.opts, key=len)
    if getattr(parameter, "is_flag", False):
        yield name
        return
    for each in values:
        yield from (name, _text(each))


def _text(value: Any) -> str:
    return str(getattr(value, "value", value))
