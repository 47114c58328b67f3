"""The sheet of a film: a head line, panels side by side, a legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

from PIL import Image, ImageDraw

from modsim3d.view import palette
from modsim3d.view.pictures.canvas import LEAST_TEXT_PX, NOMINAL_PX, TEXT_PX, font, words_apart
from modsim3d.view.pictures.legend import LegendEntry, legend

GAP_PX = 4
KEY_SHARE = 0.12
"""Height of the legend, as a share of what is above it, from which on it is set smaller."""
SEVERAL = 0.7
"""However narrow a panel, its text is as large as in one of this share of the sheet."""


@dataclass(frozen=True, eq=False)
class FilmLayout:
    """The places of everything on the sheet; its sides are even, as films need them.

    Attributes:
        width: Width of the whole sheet in pixels.
        columns: Number of panels side by side.
        aspects: Width over height of each panel, row by row.
        entries: Entries of the legend at the bottom.
        enlarged: Size of text and lines, as a multiple of the usual one.
    """

    width: int
    columns: int
    aspects: tuple[float, ...]
    entries: tuple[LegendEntry, ...]
    enlarged: float = 1.0

    @property
    def text_px(self) -> int:
        """Size of the text around the panels."""
        return max(LEAST_TEXT_PX, round(self.enlarged * TEXT_PX * self.width / NOMINAL_PX))

    @property
    def head_px(self) -> int:
        """Height of the line at the top."""
        return 2 * self.text_px

    @property
    def title_px(self) -> int:
        """Height of the titles above a row of panels; a single panel has none."""
        return round(1.7 * self.text_px) if len(self.aspects) > 1 else 0

    @property
    def nominal_width(self) -> int:
        """Width of the picture for which lines and text of a panel are meant; at least its own, if not enlarged."""
        return round(self.enlarged * max(self.panel_width, SEVERAL * self.width))

    @property
    def panel_width(self) -> int:
        """Width of each panel."""
        return (self.width - (self.columns - 1) * GAP_PX) // self.columns

    @property
    def panel_sizes(self) -> list[tuple[int, int]]:
        """Width and height of each panel in pixels."""
        return [(self.panel_width, max(1, round(self.panel_width / aspect))) for aspect in self.aspects]

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        sizes, places, y = self.panel_sizes, [], self.head_px
        for first in range(0, len(sizes), self.columns):
            row = sizes[first : first + self.columns]
            y += self.title_px
            places += [(i * (self.panel_width + GAP_PX), y) for i in range(len(row))]
            y += max(height for _, height in row) + GAP_PX
        return places

    @cached_property
    def _blank(self) -> Image.Image:
        bottom = max(y + height for (_, y), (_, height) in zip(self._places, self.panel_sizes, strict=True))
        key = legend(self.entries, self.width, self.text_px, KEY_SHARE * bottom)
        height = bottom + key.height
        sheet = Image.new("RGB", (self.width, height + height % 2), palette.PAPER)
        if key.height:
            sheet.paste(key, (0, bottom))
        return sheet

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the whole sheet in pixels; both are even."""
        return self._blank.size

    def compose(self, head: str, titles: Sequence[str], panels: Sequence[Image.Image]) -> Image.Image:
        """One picture of the film, from pictures of the sizes `panel_sizes`; a single panel shows no title."""
        sheet = self._blank.copy()
        draw = ImageDraw.Draw(sheet)
        draw.text(
            (self.text_px // 2, self.text_px // 3),
            words_apart(head, self.text_px),
            fill=palette.INK,
            font=font(self.text_px),
        )
        for title, panel, (x, y) in zip(titles, panels, self._places, strict=True):
            sheet.paste(panel, (x, y))
            if self.title_px:
                sheet.paste(_title(title, (self.panel_width, self.title_px), self.text_px), (x, y - self.title_px))
        return sheet


@lru_cache(maxsize=64)
def _title(text: str, size: tuple[int, int], text_px: int) -> Image.Image:
    """A strip of paper with a title, which it cuts if it is wider; most titles stay for a whole film."""
    strip = Image.new("RGB", size, palette.PAPER)
    ImageDraw.Draw(strip).text((text_px // 2, text_px // 4), text, fill=palette.INK, font=font(text_px))
    return strip
