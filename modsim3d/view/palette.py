"""Colours that colour-blind people can tell apart (Okabe & Ito, 2008)."""

from __future__ import annotations

Colour = tuple[int, int, int]

VESSELS: tuple[Colour, ...] = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (204, 121, 167),
    (213, 94, 0),
    (0, 114, 178),
)
SEA: Colour = (38, 52, 64)
SKY: Colour = (168, 186, 198)
TRUTH: Colour = (225, 225, 225)
ALARM: Colour = (255, 84, 84)
PAPER: Colour = (250, 250, 248)
INK: Colour = (30, 30, 30)


def vessel_colour(index: int) -> Colour:
    """The colour of a vessel, by its index in the scene; colours repeat after seven."""
    return VESSELS[index % len(VESSELS)]


def darker(colour: Colour, factor: float = 0.62) -> Colour:
    """The same hue with less light."""
    r, g, b = (int(channel * factor) for channel in colour)
    return r, g, b
