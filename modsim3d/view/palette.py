"""Colours that colour-blind people can tell apart: those of Okabe & Ito (2008), "Color Universal Design".
The vermilion among them is kept for what went wrong, so that no vessel has it; its lines differ too."""

import re
from collections.abc import Container, Iterable

Colour = tuple[int, int, int]
Colours = tuple[Colour, ...]

VESSELS: Colours = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (204, 121, 167), (0, 114, 178))
ALARM: Colour = (213, 94, 0)
OWN: Colour = (60, 40, 170)  # of vessels that carry a camera, and of no others
SEA: Colour = (38, 52, 64)
SKY: Colour = (168, 186, 198)
HORIZON: Colour = (226, 234, 238)
TRUTH: Colour = (225, 225, 225)
LAND: Colours = ((118, 132, 88), (152, 166, 120), (82, 94, 58), (200, 210, 176))
BUILT: Colours = ((141, 133, 119), (174, 167, 153), (92, 86, 75), (207, 200, 186))
"""Land is green, piers and all else that is built are grey, in pictures, on pages and on maps: plain, light, dark and
pale, in turn where obstacles are told apart."""
LAND_NAMES = re.compile("island|isle|hill|shore|skerry|land|rock|cliff|coast|mountain|reef")  # of obstacles
STATES: tuple[Colour, Colour] = ((180, 168, 216), (72, 30, 126))
"""The first and the last of a detector's performance states, pale and strong; no vessel has their hue."""
PAPER: Colour = (250, 250, 248)
INK: Colour = (30, 30, 30)
SOFT_INK: Colour = (110, 110, 110)
WHITE: Colour = (255, 255, 255)
BLACK: Colour = (0, 0, 0)
TINT, SHADE = 0.5, 0.4  # share of white or black in the second and third round of vessel colours


def vessel_colour(index: int, own_ships: Container[int] = ()) -> Colour:
    """The colour of a vessel, by its index in the scene and those of own ships, which have one of their own: six hues,
    then lighter, then darker ones, then again."""
    if index in own_ships:
        return OWN
    turn, hue = divmod(index, len(VESSELS))
    colour = VESSELS[hue]
    return (colour, mixed(colour, WHITE, TINT), mixed(colour, BLACK, SHADE))[turn % 3]


def obstacle_colours(name: str) -> Colours:
    """The four colours of an obstacle, plain, light, dark and pale: those of land if its name says that it is land."""
    return LAND if LAND_NAMES.search(name.lower()) else BUILT


def obstacle_colour(index: int, name: str) -> Colour:
    """The colour of an obstacle, by its index in the scene and its name, where obstacles are to be told apart."""
    return obstacle_colours(name)[index % len(LAND)]


def owner_colours(vessels: int, obstacles: Iterable[str], own_ships: Container[int] = ()) -> list[Colour]:
    """The colours of vessels, then those of obstacles by their names."""
    others = [obstacle_colour(index, name) for index, name in enumerate(obstacles)]
    return [*(vessel_colour(index, own_ships) for index in range(vessels)), *others]


def state_colours(states: int) -> list[Colour]:
    """The colours of a detector's performance states in the order of its file: a ramp from pale to strong."""
    first, last = STATES
    return [mixed(first, last, index / max(states - 1, 1)) for index in range(states)]


def css(colour: Colour) -> str:
    """A colour for a page."""
    return "#" + "".join(f"{channel:02x}" for channel in colour)


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """A colour with a share of another in it."""
    r, g, b = (round(c + (o - c) * share) for c, o in zip(colour, other, strict=True))
    return r, g, b


def darker(colour: Colour, factor: float = 0.62) -> Colour:
    """Colour of the same hue with less light."""
    return mixed(colour, BLACK, 1 - factor)


def unit_rgb(colour: Colour) -> tuple[float, float, float]:
    """A colour with channels from 0 to 1, for matplotlib."""
    r, g, b = (channel / 255 for channel in colour)
    return r, g, b


def ink_on(colour: Colour) -> Colour:
    """The colour of text on a plate: dark on light, light on dark."""
    luma = 0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2]
    return INK if luma > 112 else PAPER
