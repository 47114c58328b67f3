"""Colours that colour-blind people can tell apart: those of Okabe & Ito (2008), "Color Universal Design".
The vermilion among them is kept for what went wrong, so that no vessel has it; its lines differ too."""

from collections.abc import Container

Colour = tuple[int, int, int]
Colours = tuple[Colour, ...]

VESSELS: Colours = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (204, 121, 167), (0, 114, 178))
ALARM: Colour = (213, 94, 0)
OWN: Colour = (60, 40, 170)  # of vessels that carry a camera, and of no others
SEA: Colour = (38, 52, 64)
SKY: Colour = (168, 186, 198)
HORIZON: Colour = (226, 234, 238)
TRUTH: Colour = (225, 225, 225)
OBSTACLE: Colour = (141, 133, 119)  # land, piers and all else that is no vessel, in pictures, on pages and on maps
LAND: Colour = (207, 200, 186)
SOIL: Colour = (92, 86, 75)
OBSTACLES: Colours = (OBSTACLE, (174, 167, 153), SOIL, LAND)  # in turn, where they are told apart
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


def obstacle_colour(index: int) -> Colour:
    """The colour of an obstacle, by its index in the scene, where obstacles are to be told apart."""
    return OBSTACLES[index % len(OBSTACLES)]


def owner_colour(occluder: int, vessels: int, own_ships: Container[int] = ()) -> Colour:
    """The colour of a vessel, or the colour of an obstacle for an index beyond the vessels."""
    return vessel_colour(occluder, own_ships) if occluder < vessels else obstacle_colour(occluder - vessels)


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
