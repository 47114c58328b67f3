"""A detector that looks at pixels: a pretrained YOLOv8 on a whole image and on crops along the horizon.

A crop shows distant vessels larger than the whole image does. The boxes of all views go through one non-maximum
suppression, in which a box that a crop's edge has cut gives way to whole ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.boxes import intersections
from modsim3d.core.errors import ModsimError

INPUT_PX = 640
"""Side of the network's square input."""
PADDING = 114
"""Grey beside an image that is not square, as the network saw it in training."""
BOAT = 8
"""Row of the class `boat` among the 80 of COCO."""
MIN_CONFIDENCE = 0.05
"""Boxes below it are dropped; whoever uses the boxes chooses a higher threshold."""
SAME_IOU = 0.5
"""Two boxes that overlap more are of one vessel."""
SAME_SHARE = 0.6
"""So is a cut box of which more lies in another box."""
CUT_PX = 3.0
"""A box nearer than this to a crop's edge, in pixels of the network's input, counts as cut by it."""


@dataclass(frozen=True)
class View:
    """A part of an image that the network sees: its top left corner and its size in pixels of the image."""

    x: int
    y: int
    width: int
    height: int

    @property
    def scale(self) -> float:
        """Pixels of the network's input for each pixel of the image."""
        return INPUT_PX / max(self.width, self.height)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height in the network's input."""
        return round(self.width * self.scale), round(self.height * self.scale)

    @property
    def padding_px(self) -> tuple[int, int]:
        """Grey at the left and at the top in the network's input."""
        width, height = self.size_px
        return (INPUT_PX - width) // 2, (INPUT_PX - height) // 2

    def input(self, image: Image.Image) -> NDArray[np.float32]:
        """The network's input, shape (1, 3, 640, 640), red, green and blue from 0 to 1."""
        part = (self.x, self.y, self.x + self.width, self.y + self.height)
        padded = Image.new("RGB", (INPUT_PX, INPUT_PX), (PADDING,) * 3)
        padded.paste(image.resize(self.size_px, Image.Resampling.BILINEAR, box=part), self.padding_px)
        return np.ascontiguousarray(np.asarray(padded, dtype=np.float32).transpose(2, 0, 1)[None] / np.float32(255))

    def boxes(self, output: NDArray[np.float32]) -> tuple[Array, Array]:
        """Boxes of boats in pixels of the image, shape (n, 4), and their confidences, shape (n,).

        Args:
            output: Of the network: centre, width, height and the scores of 80 classes, shape (1, 84, N).
        """
        scores = output[0, 4 + BOAT].astype(np.float64)
        kept = np.flatnonzero(scores >= MIN_CONFIDENCE)
        x, y, width, height = output[0, :4, kept].astype(np.float64).T
        corners = np.stack([x - width / 2, y - height / 2, x + width / 2, y + height / 2], axis=1)
        boxes = (corners - np.tile(self.padding_px, 2)) / self.scale
        boxes = np.clip(boxes, 0, np.tile([self.width, self.height], 2)) + np.tile([self.x, self.y], 2)
        sound = (boxes[:, 2:] > boxes[:, :2]).all(axis=1)
        return boxes[sound], scores[kept][sound]

    def cut(self, boxes: Array, image_size_px: tuple[int, int]) -> Mask:
        """Whether each of n boxes in pixels of the image ends at an edge inside the image, shape (n,)."""
        near = CUT_PX / self.scale
        left, top = self.x + near, self.y + near
        right, bottom = self.x + self.width - near, self.y + self.height - near
        cut: Mask = (boxes[:, 0] < left) & (self.x > 0)
        cut |= (boxes[:, 1] < top) & (self.y > 0)
        cut |= (boxes[:, 2] > right) & (self.x + self.width < image_size_px[0])
        cut |= (boxes[:, 3] > bottom) & (self.y + self.height < image_size_px[1])
        return cut


def views_of(image_size_px: tuple[int, int], horizon_px: float, crops: int, crop_px: int) -> list[View]:
    """The whole image and square crops beside each other, whose middle is at the horizon as far as the image allows.

    Args:
        image_size_px: Width and height of the image.
        horizon_px: Row of the horizon.
        crops: Their number.
        crop_px: Their side.
    """
    width, height = image_size_px
    side = min(crop_px, width, height)
    y = round(min(max(horizon_px - side / 2, 0), height - side))
    starts = np.rint(np.linspace(0, width - side, crops)).astype(int).tolist()
    return [View(0, 0, width, height), *(View(x, y, side, side) for x in starts)]


@dataclass(frozen=True, eq=False)
class Found:
    """Boxes in pixels of the image, shape (n, 4), and their confidences, shape (n,), the most confident first."""

    boxes_px: Array
    confidence: Array


def without_repeats(boxes: Array, confidence: Array, cut: Mask) -> Found:
    """One box of each vessel: the most confident among whole ones, and a cut one only where there is no whole one.

    Args:
        boxes: Of all views, in pixels of the image, shape (n, 4).
        confidence: Shape (n,).
        cut: Whether an edge of a crop has cut each, shape (n,).
    """
    order = np.lexsort((*boxes.T, -confidence, cut))  # whole ones first; equal ones in an order that is always the same
    boxes, confidence, cut = boxes[order], confidence[order], cut[order]
    shared = intersections(boxes[:, None], boxes[None])
    area = np.diagonal(shared)
    same = shared > SAME_IOU * (area[:, None] + area - shared)
    same |= cut[:, None] & (shared > SAME_SHARE * area[:, None])
    kept = np.zeros(len(boxes), dtype=bool)
    for row in range(len(boxes)):
        kept[row] = not (same[row] & kept).any()
    best = np.argsort(-confidence[kept], kind="stable")
    return Found(boxes[kept][best], confidence[kept][best])


class Session(Protocol):
    """What runs the network, as `onnxruntime.InferenceSession` does."""

    def run(self, output_names: Sequence[str] | None, input_feed: dict[str, Any]) -> Sequence[Any]:
        """The outputs of the network."""
        ...


class PixelDetector:
    """Detects boats in images."""

    def __init__(self, session: Session, crops: int = 3, crop_px: int = 640) -> None:
        """Take what runs the network, and how many crops of which side there are beside the whole image."""
        self._session = session
        self._crops, self._crop_px = crops, crop_px

    def detect(self, image: Image.Image, horizon_px: float) -> Found:
        """Boats in an image whose horizon is at a row."""
        boxes, confidence, cut = [], [], []
        for view in views_of(image.size, horizon_px, self._crops, self._crop_px):
            found, scores = view.boxes(self._session.run(None, {"images": view.input(image)})[0])
            boxes.append(found)
            confidence.append(scores)
            cut.append(view.cut(found, image.size))
        return without_repeats(np.concatenate(boxes), np.concatenate(confidence), np.concatenate(cut))


def open_session(weights: Path) -> Session:
    """The network of an ONNX file on one thread, so that the same image gives the same bytes.

    Raises:
        ModsimError: onnxruntime is not installed, or the file is no such network.
    """
    try:
        import onnxruntime  # type: ignore[import-untyped]
    except ImportError:
        raise ModsimError("the detector that looks at pixels needs onnxruntime: pip install '.[stand_in]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(str(weights), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common base of its errors
        raise ModsimError(f"{weights}: onnxruntime cannot read it as ONNX ({error}): delete it and run again") from None
    shapes = [list(each.shape) for each in (*session.get_inputs(), *session.get_outputs())]
    if [each.name for each in session.get_inputs()] != ["images"] or shapes[0][1:] != [3, INPUT_PX, INPUT_PX]:
        raise ModsimError(f"{weights}: its inputs are {shapes}: a YOLOv8 network of 640 × 640 pixels is needed")
    found: Session = session
    return found
