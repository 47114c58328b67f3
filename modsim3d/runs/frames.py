"""Frames as users see them: truth and detections of one camera at one step, as arrays, tables, words and pictures."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import centre_form, iou
from modsim3d.core.document import Document, Result, Table, Text, Where
from modsim3d.core.errors import ModsimError
from modsim3d.core.lazy_names import public
from modsim3d.core.text import counted, in_percent, listed
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.io.validation import nearest
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import IdImage, Snapshot

if TYPE_CHECKING:
    import pyarrow as pa
    import supervision
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PICTURE_DPI = 100
FALSE_NAMES = frozenset(KINDS[kind] for kind in FALSE_KINDS)
Columns = Mapping[str, Any]


@dataclass(frozen=True, eq=False, repr=False)
class FrameTruth(Result):
    """Truth of one camera at one step: n vessels as arrays. Boxes are x_min, y_min, x_max, y_max in pixels.

    Attributes:
        vessels: IDs of the vessels.
        labels: True classes of the vessels.
        class_id: Their indices in the detector's labels, `scene.detector.labels`, shape (n,).
        full_boxes_px: Boxes of the whole silhouettes, cut at the image edge, shape (n, 4).
        visible_boxes_px: Boxes of the visible pixels; NaN if there are none, shape (n, 4).
        boxes_px: The boxes that the annotation mode takes: the full or the visible ones, shape (n, 4).
        silhouette_px: Pixels of the silhouette in the image, shape (n,).
        visible_px: Pixels of the silhouette that are seen, shape (n,).
        visible_fraction: visible_px / silhouette_px; NaN if there is no silhouette pixel, shape (n,).
        in_frame_fraction: Area in the image over area of the silhouette; NaN across the near plane, shape (n,).
        depth_m: Mean distance along the camera's axis, shape (n,).
        occluded_by: For each vessel, the names of its occluders and the number of pixels that each hides.
        annotated: Whether each vessel was given to the detector, shape (n,).
        detected: Whether each vessel was detected, under whatever label, shape (n,).
    """

    vessels: tuple[str, ...]
    labels: tuple[str, ...]
    class_id: Indices
    full_boxes_px: Array
    visible_boxes_px: Array
    boxes_px: Array
    silhouette_px: Array
    visible_px: Array
    visible_fraction: Array
    in_frame_fraction: Array
    depth_m: Array
    occluded_by: tuple[dict[str, float], ...]
    annotated: Mask
    detected: Mask

    def __len__(self) -> int:
        """Number of vessels."""
        return len(self.vessels)

    def _document(self) -> Document:
        rows = [
            (
                self.vessels[i],
                self.labels[i],
                _box(self.boxes_px[i]),
                in_percent(self.visible_fraction[i]) if np.isfinite(self.visible_fraction[i]) else "–",
                "yes" if self.annotated[i] else "no",
                "yes" if self.detected[i] else "no",
            )
            for i in range(len(self))
        ]
        header = ("vessel", "label", "box [px]", "visible", "annotated", "detected")
        return Document("", [Text(self._in_words())], [Table("Truth", header, rows, where=Where.EVERYWHERE)])

    def _in_words(self) -> str:
        names = f" ({listed(self.vessels)})" if len(self) else ""
        return (
            f"{counted(len(self), 'vessel')}{names}, {np.count_nonzero(self.annotated)} annotated, "
            f"{np.count_nonzero(self.detected)} detected"
        )


@dataclass(frozen=True, eq=False, repr=False)
class FrameDetections(Result):
    """The detector's output for one frame: m detections as arrays, in shuffled order.

    Attributes:
        labels: Detected classes.
        class_id: Their indices in the detector's labels, `scene.detector.labels`, shape (m,).
        confidence: In [0, 1], shape (m,).
        boxes_px: x_min, y_min, x_max, y_max, shape (m, 4).
        kinds: Origin of each detection: `true`, `false_positive`, `persistent_false_positive`, `duplicate`, `merged`,
            `split`, `fragment` or `on_vessel`.
        vessels: ID of the vessel that each detection came from, None for a false positive. A tracker must not read it.
        errors_px: e_x, e_y, e_w, e_h before clipping, NaN for false positives, shape (m, 4).
    """

    labels: tuple[str, ...]
    class_id: Indices
    confidence: Array
    boxes_px: Array
    kinds: tuple[str, ...]
    vessels: tuple[str | None, ...]
    errors_px: Array

    def __len__(self) -> int:
        """Number of detections."""
        return len(self.labels)

    def _document(self) -> Document:
        vessels, boxes = [vessel or "–" for vessel in self.vessels], map(_box, self.boxes_px)
        confidence = [f"{value:.2f}" for value in self.confidence]
        rows = list(zip(self.labels, confidence, boxes, self.kinds, vessels, strict=True))
        header = ("label", "confidence", "box [px]", "kind", "vessel")
        return Document("", [Text(self._in_words())], [Table("Detections", header, rows, where=Where.EVERYWHERE)])

    def _in_words(self) -> str:
        kinds = [f"{count} {kind}" for kind, count in Counter(self.kinds).items()]
        return counted(len(self), "detection") + (f" ({', '.join(kinds)})" if kinds else "")


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One camera at one step, from `simulate_frames` or `StoredRun.frames`.

        frame.time_s, frame.truth.boxes_px, frame.detections.confidence

    Attributes:
        camera: Name of the camera.
        step: Step, counted from zero.
        timestamp: The text of the step's time, as files have it.
        time_s: Time since the scene's first step, in seconds.
        state: Name of the detector's performance state.
        truth: What the camera sees.
        detections: What the detector makes of it.
        image_size_px: Width and height.
        sea_half_plane: (a, b, c) with a·x + b·y + c >= 0 on the sea's side of the horizon, shape (3,).
        scene_vessels: IDs of all vessels of the scene, seen or not; their order gives the colours of pictures.
        scene: The scene, for the picture; None in a frame that was made without one.
    """

    camera: str
    step: int
    timestamp: str
    time_s: float
    state: str
    truth: FrameTruth
    detections: FrameDetections
    image_size_px: tuple[int, int]
    sea_half_plane: Array
    scene_vessels: tuple[str, ...]
    scene: Scene | None = None

    def __repr__(self) -> str:
        """Camera, step, time and how much is in it."""
        return f"<Frame: {self._in_words()}>"

    def _repr_html_(self) -> str | None:
        if find_spec("matplotlib") is not None:
            return None
        tables = self.truth._document().notebook() + self.detections._document().notebook()
        return f"<p>{escape(self._in_words())}</p>{tables}"

    def _repr_png_(self) -> bytes | None:
        """A notebook's picture; None without matplotlib."""
        if find_spec("matplotlib") is None:
            return None
        picture = io.BytesIO()
        self.plot().savefig(picture, format="png", dpi=PICTURE_DPI)
        return picture.getvalue()

    def _in_words(self) -> str:
        return (
            f"camera {self.camera}, step {self.step}, {self.time_s:g} s, detector {self.state}: "
            f"{counted(len(self.truth), 'vessel')}, {counted(len(self.detections), 'detection')}"
        )

    def id_image(self) -> IdImage:
        """Draw who is in front at each pixel: `ids` of shape (height, width), 0 for nothing, and the `names` of IDs.

        Raises:
            ModsimError: The frame was made without a scene.
            RendererError: There is no OpenGL library.
        """
        return self._snapshot().render_ids(self.camera)

    def silhouette(self, vessel: str) -> Mask:
        """The pixels of a vessel drawn alone, parts that others hide included, of the shape of `id_image().ids`.

        Raises:
            ModsimError: There is no such vessel, or the frame was made without a scene.
            RendererError: There is no OpenGL library.
        """
        return self._snapshot().render_silhouette(self.camera, vessel)

    def _snapshot(self) -> Snapshot:
        if self.scene is None:
            raise ModsimError("this frame has no scene that could be drawn: take one from simulate_frames or open_run")
        return self.scene.at(self.step)

    def table(self, name: str) -> pa.Table:
        """Its rows of a run's table: `frames`, `truth` or `detections`, with the columns of `StoredRun.table`.

        Raises:
            ModsimError: There is no such table.
        """
        import pyarrow as pa  # takes longer than a frame

        from modsim3d.runs.files.table_columns import schema_of

        tables = {"frames": _frame_columns, "truth": _truth_columns, "detections": _detection_columns}
        if name not in tables:
            raise ModsimError(f"there is no table '{name}' of a frame ({nearest(name, tables)})")
        columns, rows = tables[name](self), {"frames": 1, "truth": len(self.truth), "detections": len(self.detections)}
        keys = {key: [getattr(self, key)] * rows[name] for key in ("camera", "step", "timestamp", "state")}
        every, schema = {**keys, **columns}, schema_of(name)
        arrays = [pa.array(every[field.name], field.type, from_pandas=True) for field in schema]  # null for NaN
        return pa.table(arrays, schema=schema)

    def to_supervision(self) -> supervision.Detections:
        """The detections as `supervision.Detections`: `xyxy`, `confidence`, `class_id` and `data["class_name"]`.

        Raises:
            ModsimError: supervision is not installed.
        """
        detections = self.detections
        return _supervision().Detections(
            xyxy=detections.boxes_px.copy(),
            confidence=detections.confidence.copy(),
            class_id=detections.class_id.copy(),
            data={"class_name": np.array(detections.labels, dtype=str)},
        )

    def truth_to_supervision(self) -> supervision.Detections:
        """The annotated vessels as `supervision.Detections`, with the boxes that the annotation mode takes.

        `tracker_id` is the place of each vessel in `scene_vessels`; `data["vessel"]` is its ID. There is no confidence.

        Raises:
            ModsimError: supervision is not installed.
        """
        truth = self.truth
        rows = np.flatnonzero(truth.annotated)
        numbers = {name: number for number, name in enumerate(self.scene_vessels)}
        return _supervision().Detections(
            xyxy=truth.boxes_px[rows],
            class_id=truth.class_id[rows],
            tracker_id=np.array([numbers[truth.vessels[row]] for row in rows], dtype=np.int64),
            data={
                "class_name": np.array([truth.labels[row] for row in rows], dtype=str),
                "vessel": np.array([truth.vessels[row] for row in rows], dtype=str),
            },
        )

    def plot(self, axes: Axes | None = None, *, zoom: bool = False, labels: bool = True) -> Figure:
        """Draw the picture of the films, with axes in pixels; a notebook shows the matplotlib figure that is returned.

        Args:
            axes: Axes to draw into; a new figure if None.
            zoom: Show only the part of the image with vessels.
            labels: Write names, classes and confidences.

        Raises:
            ModsimError: matplotlib is not installed.
        """
        figure: Figure = public("plot_frame")(self, axes, zoom=zoom, labels=labels)
        return figure


def _box(box_px: Array) -> str:
    return ", ".join(f"{side:.1f}" for side in box_px) if np.isfinite(box_px).all() else "–"


def _supervision() -> Any:
    try:
        import supervision
    except ImportError:
        raise ModsimError("this needs the library supervision: pip install 'modsim3d[supervision]'") from None
    return supervision


def _frame_columns(frame: Frame) -> Columns:
    false = sum(kind in FALSE_NAMES for kind in frame.detections.kinds)
    return {
        "n_annotated": [np.count_nonzero(frame.truth.annotated)],
        "n_detected": [len(frame.detections) - false],
        "n_false": [false],
    }


def _truth_columns(frame: Frame) -> Columns:
    from modsim3d.runs.files.table_columns import BOX_SIDES, TRUTH_NUMBERS

    truth = frame.truth
    return {
        "vessel": truth.vessels,
        "label": truth.labels,
        **{f"full_{side}": truth.full_boxes_px[:, i] for i, side in enumerate(BOX_SIDES)},
        **{f"visible_{side}": truth.visible_boxes_px[:, i] for i, side in enumerate(BOX_SIDES)},
        **{name: getattr(truth, name) for name in TRUTH_NUMBERS},
        "occluded_by": [[{"id": name, "px": px} for name, px in counts.items()] for counts in truth.occluded_by],
        "annotated": truth.annotated,
        "detected": truth.detected,
    }


def detected_rows(frame: Frame) -> list[int | None]:
    """Row of a frame's truth that each of its detections detects, None for a false positive. A duplicate and the
    smaller part of a split box are false positives, though they come from a vessel."""
    row_of: dict[str | None, int] = {vessel: row for row, vessel in enumerate(frame.truth.vessels)}
    pairs = zip(frame.detections.kinds, frame.detections.vessels, strict=True)
    return [None if kind in FALSE_NAMES or vessel is None else row_of[vessel] for kind, vessel in pairs]


def _detection_columns(frame: Frame) -> Columns:
    from modsim3d.runs.files.table_columns import BOX_SIDES, CENTRE_FORM, ERRORS

    detections, rows = frame.detections, detected_rows(frame)
    annotated_px = [[np.nan] * 4 if row is None else frame.truth.boxes_px[row] for row in rows]
    return {
        "detection": np.arange(len(detections)),
        "label": detections.labels,
        "confidence": detections.confidence,
        **dict(zip(CENTRE_FORM, centre_form(detections.boxes_px).T, strict=True)),
        **dict(zip(BOX_SIDES, detections.boxes_px.T, strict=True)),
        "kind": detections.kinds,
        "vessel": detections.vessels,
        **dict(zip(ERRORS, detections.errors_px.T, strict=True)),
        "iou": iou(detections.boxes_px, np.reshape(annotated_px, (-1, 4))),
    }
