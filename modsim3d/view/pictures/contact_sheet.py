"""One PNG that shows at a glance what happened in a run."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from PIL import Image, ImageDraw

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import areas, unions
from modsim3d.io.atomic_write import encoded, put_in_place
from modsim3d.render.id_pass import AnyIdRenderer
from modsim3d.runs.counts import Outcome, faults_of, having
from modsim3d.runs.files.stored_tables import StoredTables
from modsim3d.runs.files.table_columns import BOX_SIDES
from modsim3d.runs.files.tables import flags, number_column
from modsim3d.runs.frames import Frame
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.pictures.canvas import Box, Label, Window, font, text_size
from modsim3d.view.pictures.close_up import close_up, inset_of
from modsim3d.view.pictures.frame_picture import CameraView
from modsim3d.view.pictures.layers import DETECTIONS, WEATHER, fate
from modsim3d.view.pictures.legend import detection_entries, legend
from modsim3d.view.pictures.plain import open_id_renderer
from modsim3d.world.bodies import PREFIX

# ---- Frames of a run that are worth looking at ----

Rows = TypeVar("Rows")


@dataclass(frozen=True)
class Highlight:
    """A frame of a run, the box to look at in it, the vessel if it is about one, and what happens there."""

    step: int
    camera: str
    focus_px: Box
    vessel: str | None
    what: str = ""


def pick_highlights(tables: StoredTables, scene: Scene) -> list[Highlight]:
    """One highlight of each kind that a finished run has: occlusion, a miss, a wrong class, a bad box, ..."""
    of_truth = _least(tables.by_name["truth"].groups(), _truth_ranks, _of_truth)
    return of_truth + _least(_detection_groups(tables, scene), _detection_ranks, _of_detection)


def _truth_ranks(truth: pa.Table) -> list[Array]:
    """For each kind of highlight the rank of each row, shape (n,): the least is shown, an infinite one never."""
    fraction = np.nan_to_num(number_column(truth, "visible_fraction"), nan=1.0)
    silhouette_px, visible_px = number_column(truth, "silhouette_px"), number_column(truth, "visible_px")
    occluded = pc.list_value_length(truth["occluded_by"]).to_numpy() > 0
    annotated, detected = flags(truth, "annotated"), flags(truth, "detected")
    partly_hidden = occluded & (fraction > 0) & (fraction < 1) & annotated
    kinds = (
        (partly_hidden & detected, np.abs(fraction - 0.5)),
        (partly_hidden & ~detected, fraction),
        ((visible_px == 0) & occluded, -silhouette_px),
        ((fraction == 1) & annotated & ~detected, -silhouette_px),
    )
    return [np.where(wanted, rank, np.inf) for wanted, rank in kinds]


def _of_truth(truth: pa.Table, index: int) -> Highlight:
    row = truth.slice(index, 1).to_pylist()[0]
    box = tuple(row[f"full_{side}"] for side in BOX_SIDES)
    what = _hidden_by(row) if row["occluded_by"] else "in plain view"
    return Highlight(row["step"], row["camera"], box, row["vessel"], what)


def _hidden_by(row: dict[str, Any]) -> str:
    hider = max(row["occluded_by"], key=lambda entry: entry["px"])["id"].removeprefix(PREFIX)
    if row["visible_fraction"] == 0:
        return f"wholly hidden by {hider}"
    hidden = min(1 - row["visible_fraction"], 0.99)  # something is seen: "100 %" would be another thing
    return f"{100 * hidden:.0f} % hidden by {hider}"


def _detection_groups(tables: StoredTables, scene: Scene) -> Iterable[RunRows]:
    """The detections, row group by row group, with the truth of their steps."""
    for detections in tables.by_name["detections"].groups():
        if not len(detections):
            continue
        first, stop = detections["step"][0].as_py(), detections["step"][-1].as_py() + 1
        others = {name: tables.by_name[name].rows(first, stop).table for name in ("frames", "truth")}
        yield RunRows.of_tables(scene, scene.steps, {**others, "detections": detections})


def _detection_ranks(rows: RunRows) -> list[Array]:
    """As `_truth_ranks`: the largest one of each kind."""
    size, outcome = areas(rows.detection_boxes_px()), rows.outcomes
    has = {flag: having(outcome, flag) for flag in Outcome}
    true = ~has[Outcome.FALSE_POSITIVE]
    vessel_size = np.zeros(len(size))
    vessel_size[true] = areas(rows.annotated_boxes_px[rows.detected_row[true]])
    kinds = (
        (outcome == 0, vessel_size),
        (has[Outcome.MISLABELLED], vessel_size),
        (has[Outcome.BELOW_HALF_IOU] & ~has[Outcome.OFF_VESSEL], vessel_size),
        (has[Outcome.OFF_VESSEL], vessel_size),
        (has[Outcome.FALSE_POSITIVE], size),
    )
    return [np.where(wanted, -most, np.inf) for wanted, most in kinds]


def _of_detection(rows: RunRows, index: int) -> Highlight:
    row = rows.detections.slice(index, 1).to_pylist()[0]
    box, vessel, what = rows.detection_boxes_px()[index : index + 1], row["vessel"], ""
    if rows.outcomes[index] & Outcome.FALSE_POSITIVE:
        double = f", {row['kind']} of {vessel}" if vessel else ""
        what = f"a false positive{double}: {row['label']} {row['confidence']:.2f}"
        vessel = None
    else:
        box = unions(box, rows.annotated_boxes_px[rows.detected_row[index : index + 1]])
    x0, y0, x1, y1 = box[0].tolist()
    return Highlight(row["step"], row["camera"], (x0, y0, x1, y1), vessel, what)


def _least(
    groups: Iterable[Rows], ranks_of: Callable[[Rows], list[Array]], highlight_of: Callable[[Rows, int], Highlight]
) -> list[Highlight]:
    """For each kind that there is, the highlight of the row that ranks least."""
    leaders: dict[int, tuple[float, Highlight]] = {}
    for rows in groups:
        for kind, rank in enumerate(ranks_of(rows)):
            least = float(rank.min(initial=np.inf))
            if least < (leaders[kind][0] if kind in leaders else np.inf):
                leaders[kind] = least, highlight_of(rows, int(np.argmin(rank)))
    return [leaders[kind][1] for kind in sorted(leaders)]


SHEET_FILE = "contact_sheet.png"
PANEL_PX = (720, 440)
COLUMNS = 2
GAP_PX, CAPTION_PX = 16, 68
TITLE_PX, CAPTION_TEXT_PX, TEXT_PX = 30, 26, 20  # sizes of text, which a page shows at about 60 %
MIN_TEXT_PX = 17  # of a long caption; one that is longer still is cut
NOMINAL_WIDTH_PX = 1700  # of a picture for which the lines and the text of a panel are meant
INSET_PX = (124, 62)


def draw_contact_sheet(run: StoredRun) -> Path:
    """Draw the contact sheet of a finished run into its folder: panels of frames that are worth a look."""
    path = run.folder / SHEET_FILE
    with open_id_renderer(run.scene) as id_renderer:
        sheet = _sheet(run, pick_highlights(run.finished_tables, run.scene), id_renderer)
    with put_in_place(path) as partial:
        partial.write_bytes(encoded(sheet))
    return path


def _sheet(run: StoredRun, highlights: list[Highlight], id_renderer: AnyIdRenderer) -> Image.Image:
    scene, annotation = run.scene, run.scene.annotation
    rows = max(1, -(-len(highlights) // COLUMNS))
    width = COLUMNS * (PANEL_PX[0] + GAP_PX) + GAP_PX
    frames = [run.frame(highlight.camera, highlight.step) for highlight in highlights]
    key = legend(detection_entries(DETECTIONS, annotation.mode, faults_of(frames)), width, TEXT_PX)
    foot = rows * (PANEL_PX[1] + CAPTION_PX + GAP_PX) + 2 * GAP_PX + TITLE_PX
    sheet = Image.new("RGB", (width, foot + key.height), palette.PAPER)
    draw = ImageDraw.Draw(sheet)
    title = f"{scene.name}: annotation mode {annotation.mode}, {annotation.source} truth, seed {scene.seed} ({WEATHER})"
    draw.text((GAP_PX, GAP_PX // 2), title, fill=palette.INK, font=font(TITLE_PX))
    if not highlights:
        draw.text((GAP_PX, 3 * GAP_PX + TITLE_PX), "No vessel was in any image.", fill=palette.INK, font=font(TEXT_PX))
    for i, (highlight, frame) in enumerate(zip(highlights, frames, strict=True)):
        x = GAP_PX + (i % COLUMNS) * (PANEL_PX[0] + GAP_PX)
        y = 2 * GAP_PX + TITLE_PX + (i // COLUMNS) * (PANEL_PX[1] + CAPTION_PX + GAP_PX)
        sheet.paste(_tile(highlight, CameraView.of(scene, frame), id_renderer), (x, y))
    sheet.paste(key, (0, foot))
    return sheet


def _caption(highlight: Highlight, frame: Frame) -> str:
    if highlight.vessel is None:
        return highlight.what
    annotated = frame.truth.annotated[frame.truth.vessels.index(highlight.vessel)]
    words = highlight.what, fate(frame, highlight.vessel) if annotated else ""
    return f"{highlight.vessel}: {', '.join(filter(None, words))}"


def _tile(highlight: Highlight, camera_view: CameraView, id_renderer: AnyIdRenderer) -> Image.Image:
    """A highlight under its caption; its place in the whole image is beside the caption, where it covers nothing."""
    frame, image_size = camera_view.frame, camera_view.image_size_px
    window = Window.around(highlight.focus_px, image_size, PANEL_PX)
    tile = Image.new("RGB", (PANEL_PX[0], PANEL_PX[1] + CAPTION_PX), palette.PAPER)
    draw = ImageDraw.Draw(tile)
    inset = inset_of(camera_view, window, INSET_PX)
    caption, room = _caption(highlight, frame), PANEL_PX[0] - inset.width - GAP_PX
    fitting = (size for size in range(CAPTION_TEXT_PX, MIN_TEXT_PX, -1) if text_size(caption, size)[2] <= room)
    size = next(fitting, MIN_TEXT_PX)
    draw.text((0, 2), _shortened(caption, size, room), fill=palette.INK, font=font(size))
    place = f"{frame.camera}, {frame.timestamp} s, detector {frame.state}"
    draw.text((0, CAPTION_PX - TEXT_PX - 10), place, fill=palette.SOFT_INK, font=font(TEXT_PX))
    draw.rectangle((room, 0, PANEL_PX[0], CAPTION_PX), fill=palette.PAPER)
    tile.paste(inset, (PANEL_PX[0] - inset.width, (CAPTION_PX - inset.height) // 2))
    tile.paste(_panel(highlight, camera_view, window, id_renderer), (0, CAPTION_PX))
    return tile


def _shortened(text: str, size: int, room: int) -> str:
    """A text that is cut, with an ellipsis, where it is wider than there is room."""
    if text_size(text, size)[2] <= room:
        return text
    return next(cut for end in range(len(text), -1, -1) if text_size(cut := f"{text[:end]}…", size)[2] <= room)


def _panel(highlight: Highlight, camera_view: CameraView, window: Window, id_renderer: AnyIdRenderer) -> Image.Image:
    """The part of the image around a highlight, with an arrow at it; only what it is about has labels."""
    focus = window.corners(np.array(highlight.focus_px))

    def wanted(label: Label) -> bool:
        return label.vessel == highlight.vessel and (label.vessel is not None or np.allclose(label.box, focus))

    seen, drawn = camera_view.frame.truth.visible_boxes_px, camera_view.frame.detections.boxes_px
    boxes = np.concatenate([seen[~np.isnan(seen).any(axis=1)], drawn])
    options: dict[str, Any] = {"nominal_width_px": NOMINAL_WIDTH_PX, "wanted": wanted, "clear_of": list(boxes)}
    return close_up(camera_view, window, np.array(highlight.focus_px), DETECTIONS, id_renderer, **options)
