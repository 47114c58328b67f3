"""The fast path of the rendered source, held pixel by pixel against what OpenGL draws of every frame.

The drawing is the cross-check's (`truth.crosscheck`): its projection, clipping and order have nothing in common with
the fast path, nor with the analytic source.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Mask
from modsim3d.render.id_pass import IdRenderer, Region
from modsim3d.truth.crosscheck.comparison import Checked, Difference, SaidOfFrame, check_frame, mask_of
from modsim3d.truth.crosscheck.drawing import Drawing
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.pixel_masks import PixelMasks
from modsim3d.truth.pixel_spans import Spans
from modsim3d.truth.rendered import spans_of_frame


@dataclass(frozen=True, eq=False)
class FastPath:
    """What the fast path says about outlines.

    Attributes:
        outlines: The vessels and obstacles in F frames.
        occlusion: Their counts, boxes and occluders.
        spans: Their pixels: of whole silhouettes, and of what is visible.
    """

    outlines: Outlines
    occlusion: Occlusion
    spans: tuple[Spans, Spans]

    def masks(self, row: int, drawings: Sequence[Drawing]) -> PixelMasks:
        """The pixels of a row, in a buffer like that of the drawings of the F frames."""
        like = drawings[0]
        region = Region.around(self.outlines.boxes_px[row] * like.supersample, like.size_px)
        silhouette, visible = (mask_of(spans.take(spans.row == row), region) for spans in self.spans)
        return PixelMasks(region, silhouette, visible)

    def compare(
        self, drawings: Sequence[Drawing], boxed: Mask, names: Sequence[str], renderer: IdRenderer
    ) -> tuple[Checked, dict[int, str], int]:
        """Draw the F frames, and compare.

        Args:
            drawings: One of each frame.
            boxed: Which of the scene's V vessels get a box if they are in the image, shape (F, V).
            names: Of the scene's occluders.
            renderer: Draws them.

        Returns:
            How much was drawn; row → how it differs; and the number of vessels that were drawn and have no row.
        """
        truth = self.occlusion.truth(self.outlines, np.arange(len(drawings)), camera=0)
        checked = Checked(from_spans=int((~truth.drawn).sum()), from_buffers=int(truth.drawn.sum()))
        words: dict[int, str] = {}
        missing = 0
        for frame, drawing in enumerate(drawings):
            silhouettes, visible = (spans_of_frame(each, self.outlines, frame) for each in self.spans)
            said = SaidOfFrame(truth.take(truth.step == frame), silhouettes, visible, areas={})
            vessels = set(np.flatnonzero(boxed[frame]).tolist())
            while True:  # until all vessels that differ are left out
                try:
                    checked += check_frame(drawing, renderer, said, vessels, names)
                    break
                except Difference as each:
                    own = said.truth.vessel == each.vessel
                    said, vessels = replace(said, truth=said.truth.take(~own)), vessels - {each.vessel}
                    missing += not own.any()
                    row = self.outlines.boxed & (self.outlines.frame == frame) & (self.outlines.occluder == each.vessel)
                    text = f"{each.what}: {each.truth} in the truth, {each.drawn} drawn"
                    words |= dict.fromkeys(np.flatnonzero(row).tolist(), text)
        return checked, words, missing
