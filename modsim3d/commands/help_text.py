"""What `-h` shows, where typer's own would mislead."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup


class Command(TyperCommand):
    """A command whose flags are shown as flags: typer calls them <bool>, as if they took a value."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as help shows them."""
        return _plain(super().get_params(ctx))


class Group(TyperGroup):
    """A group of commands, as `Command`."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as help shows them."""
        return _plain(super().get_params(ctx))


def _plain(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    return parameters
