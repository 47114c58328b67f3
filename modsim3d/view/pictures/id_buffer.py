"""ID buffers as files, and the picture of a vessel on which two of them differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modsim3d.arrays import Mask
from modsim3d.errors import ModsimError
from modsim3d.outputs.pictures import encoded
from modsim3d.outputs.placing import written_whole
from modsim3d.scene.snapshot import IdImage
from modsim3d.view import palette

MOST_IN_PNG = 2**16 - 1
GAP_PX, MIN_SIDE_PX = 4, 200


def write_id_buffer(image: IdImage, path: Path) -> None:
    """Write IDs as NumPy's `.npy`, or as a grey PNG of 16 bits, whose values they are.

    Raises:
        ModsimError: An ID is too large for a PNG.
    """
    if path.suffix.lower() == ".npy":
        with written_whole(path) as partial, partial.open("wb") as file:
            np.save(file, image.ids)
        return
    if int(image.ids.max(initial=0)) > MOST_IN_PNG:
        raise ModsimError(f"{path}: a PNG holds IDs up to {MOST_IN_PNG}; give --out a name that ends in .npy")
    with written_whole(path) as partial:
        partial.write_bytes(encoded(image.ids.astype(np.uint16)))


def write_difference(masks: tuple[Mask, Mask], path: Path) -> None:
    """Write the pixels of a vessel in the truth, as they were drawn, and where they differ, side by side as a PNG."""
    truth, drawn = masks
    gap = np.full((len(truth), GAP_PX, 3), palette.PAPER, dtype=np.uint8)
    panels = [np.where(mask[..., None], palette.VESSELS[2], (0, 0, 0)) for mask in (truth, drawn, truth ^ drawn)]
    picture = np.concatenate([panels[0], gap, panels[1], gap, panels[2]], axis=1).astype(np.uint8)
    scale = max(1, -(-MIN_SIDE_PX // max(len(truth), 1)))
    with written_whole(path) as partial:
        partial.write_bytes(encoded(np.kron(picture, np.ones((scale, scale, 1), dtype=np.uint8))))
