"""The sheet of a film: a line that says what and when, panels side by side, a key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from PIL import Image, ImageDraw

from modsim3d.view import palette
from modsim3d.view.legend import Entry, legend
from modsim3d.view.pen import LEAST_TEXT_PX, NOMINAL_PX, TEXT_PX, font, text_size

GAP_PX = 4
SEVERAL = 0.7
"""However narrow a panel, its text is as large as in one of this share of the sheet."""


@dataclass(frozen=True, eq=False)
class FilmLayout:
    """Where everything goes; all sides are even, as films want them.

    Attributes:
        width: Of the whole sheet.
        columns: Panels side by side.
        aspects: Width over height of each panel, row by row.
        entries: Of the key.
    """

    width: int
    columns: int
    aspects: tuple[float, ...]
    entries: tuple[Entry, ...]

    @property
    def text_px(self) -> int:
        """Size of the text around the panels."""
        return max(LEAST_TEXT_PX, round(TEXT_PX * self.width / NOMINAL_PX))

    @property
    def head_px(self) -> int:
        """Height of the line at the top."""
        return 2 * self.text_px

    @property
    def nominal_width(self) -> int:
        """The width that lines and text in a panel are meant for: more than its own if it is one of several."""
        return max(self.panel_width, round(SEVERAL * self.width))

    @property
    def panel_width(self) -> int:
        """Of each panel."""
        return (self.width - (self.columns - 1) * GAP_PX) // self.columns

    @property
    def panel_sizes(self) -> list[tuple[int, int]]:
        """Width and height of each panel."""
        return [(self.panel_width, max(1, round(self.panel_width / aspect))) for aspect in self.aspects]

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        sizes, places, y = self.panel_sizes, [], self.head_px
        for first in range(0, len(sizes), self.columns):
            row = sizes[first : first + self.columns]
            places += [(i * (self.panel_width + GAP_PX), y) for i in range(len(row))]
            y += max(height for _, height in row) + GAP_PX
        return places

    @cached_property
    def _blank(self) -> Image.Image:
        key = legend(self.entries, self.width, self.text_px)
        bottom = max(y + height for (_, y), (_, height) in zip(self._places, self.panel_sizes, strict=True))
        height = bottom + key.height
        sheet = Image.new("RGB", (self.width, height + height % 2), palette.PAPER)
        if key.height:
            sheet.paste(key, (0, bottom))
        return sheet

    def compose(self, head: str, titles: Sequence[str], panels: Sequence[Image.Image]) -> Image.Image:
        """One picture of the film.

        Args:
            head: The line at the top.
            titles: Of the panels; shown in them if there are several.
            panels: Of the sizes that `panel_sizes` asks for.
        """
        sheet = self._blank.copy()
        draw = ImageDraw.Draw(sheet)
        draw.text((self.text_px // 2, self.text_px // 3), head, fill=palette.INK, font=font(self.text_px))
        for title, panel, place in zip(titles, panels, self._places, strict=True):
            sheet.paste(panel, place)
            if len(panels) > 1:
                _, top, _, bottom = text_size("Ag", self.text_px)
                right = text_size(title, self.text_px)[2]
                pad = self.text_px // 3
                x, y = place
                draw.rectangle((x, y, x + right + 2 * pad, y + bottom - top + 2 * pad), fill=palette.PAPER)
                draw.text((x + pad, y + pad - top), title, fill=palette.INK, font=font(self.text_px))
        return sheet
