"""A comparison of sources as terminal tables, `compare.json` and a page."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import orjson
from PIL import Image

from modsim3d.core.document import Block, Document, Figure, Fold, Heading, Result, Table, Text, Tiles, Where
from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import counted, in_percent
from modsim3d.io.atomic_write import encoded, write_files
from modsim3d.io.overwrite_guard import claimed
from modsim3d.render.id_pass import IdRenderer
from modsim3d.runs.pipeline import open_renderer
from modsim3d.runs.selection import check_every
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.truth.analytic import visible_regions
from modsim3d.verify.sources.agreement import BoxFigures, ComparisonFigures, RuleFigures, VesselDifference
from modsim3d.verify.sources.compare import RULE_OFF_PX, SourceComparison, compare_sources
from modsim3d.view.pages.page import document_page, image
from modsim3d.view.pages.provenance import Input, Provenance, sha256_of, shown_path
from modsim3d.view.pictures.comparison_picture import RULE, Styles, boxes_that_differ, comparison_picture
from modsim3d.view.pictures.plain import Solids

FILES = ("compare.json", "compare.html", "rectangle_rule.png")
Rows = list[tuple[str, str]]


def document(comparison: SourceComparison, scene: Scene, renderer: IdRenderer | None = None) -> Document:
    """The comparison, to be read; its pictures need a renderer. A page has no times."""
    figures, rule = comparison.figures, comparison.figures.rectangles_against_rendered
    wrong = in_percent(rule.wrong_share, 1)
    summary = f"{figures.vessel_frames:,} vessel-frames compared: {figures.unexplained:,} unexplained differences"
    agreed, largest = ("Agreement", "Full box", "Visible part"), "largest difference of a side"
    full, visible, whole = figures.full_box.verdicts, figures.visible_box.verdicts, figures.vessel_frames
    verdicts = [(name, _share(full[name], whole), _share(visible[name], whole)) for name in full]
    tables = [Table("", (), _figure_rows(figures)), Table("", agreed, verdicts)]
    times = [(source, f"{milliseconds:.2f} ms") for source, milliseconds in figures.ms_per_frame.items()]
    return Document(
        f"{scene.name}: sources of truth compared",
        _introduction(figures),
        [
            Tiles(
                [
                    ("Unexplained", f"{figures.unexplained:,}", f"of {figures.vessel_frames:,} vessel-frames"),
                    ("Full box", f"{figures.full_box.side_max_px:.2f} px", largest),
                    ("Visible box", f"{figures.visible_box.side_max_px:.2f} px", largest),
                    ("Rectangle rule wrong", wrong, f"of {rule.occluded:,} occluded vessel-frames"),
                ]
            ),
            Heading("Rendered against drawn and analytic"),
            Fold(summary, tables, opened=figures.unexplained > 0),
            Heading("The idealised rectangle rule against rendered"),
            Table("", (), _rule_rows(rule)),
            Heading("Time per frame"),
            Table("", (), times, where=Where.TERMINAL),
            Heading("No plane between the hulls"),
            Table("", (), [(pair, f"{frames} frames") for pair, frames in figures.intersecting.items()]),
            Heading("Shoebox against mesh"),
            _shoeboxes(figures),
            *(_pictures(comparison, scene, renderer) if renderer else ()),
        ],
    )


def _figure_rows(figures: ComparisonFigures) -> Rows:
    """Figures in rows: what was drawn, whether the rendered truth is the same, and how the analytic truth differs."""
    fraction, drawn = figures.visible_fraction, figures.drawn
    return [
        ("vessel-frames compared", f"{figures.vessel_frames:,} in {figures.frames:,} frames"),
        ("drawn by OpenGL", f"{drawn.vessels:,} silhouettes alone, {drawn.frames - drawn.empty_frames:,} scenes"),
        ("pixels compared with what was drawn", f"{drawn.pixels:,} of silhouettes, alone and in the scene"),
        ("rendered truth", f"{drawn.from_spans:,} vessel-frames from spans, {drawn.from_buffers:,} from buffers"),
        ("not as it was drawn", f"{figures.differs_from_drawn:,} vessel-frames, and {figures.missing:,} missing"),
        ("pixels that differ where rounding decides", f"{drawn.tie_pixels:,}"),
        ("partly or wholly hidden", _share(figures.occluded, figures.vessel_frames)),
        ("full box, side differences", _sides(figures.full_box)),
        ("visible box, side differences", _sides(figures.visible_box)),
        ("visible fraction, differences", _up_to(fraction.max, fraction.p99, 4)),
        ("fraction differences that boundary pixels do not explain", f"{fraction.above_bound:,}"),
        ("visible to one source only", f"{figures.visible_at_all_differs:,}"),
        ("every pixel checked against geometry", counted(figures.pixels_looked_at, "vessel-frame")),
        ("UNEXPLAINED", f"{figures.unexplained:,}"),
    ]


def _rule_rows(rule: RuleFigures) -> Rows:
    return [
        ("occluded vessel-frames", f"{rule.occluded:,}"),
        (f"a side off by more than {RULE_OFF_PX:g} px", _share(rule.box_off_by_more_than_2_px, rule.occluded)),
        ("hidden vessel kept", _share(rule.hidden_vessel_kept, rule.occluded)),
        ("visible vessel dropped", _share(rule.visible_vessel_dropped, rule.occluded)),
        ("wrong in total", in_percent(rule.wrong_share, 1)),
    ]


def _shoeboxes(figures: ComparisonFigures) -> Table:
    """Room that the shoebox of each vessel with a mesh leaves around it."""
    header = ("vessel", "mean area over the mesh's", "at most", "farthest side, px", "frames within a pixel")
    rows = []
    for vessel, fit in figures.shoebox_against_mesh.items():
        ratios = f"{fit.mean_area_ratio:.2f}", f"{fit.max_area_ratio:.2f}"
        rows.append((vessel, *ratios, f"{fit.max_side_px:.1f}", _share(fit.within_a_pixel, fit.frames)))
    return Table("", header, rows)


def _pictures(comparison: SourceComparison, scene: Scene, renderer: IdRenderer) -> Iterator[Block]:
    findings = comparison.findings
    yield Heading("The rectangle rule's worst mistake")
    if findings.rule.worst:
        yield _picture(scene, findings.rule.worst, renderer, RULE)
    yield Heading("The largest differences between rendered and analytic")
    for case in findings.worst:
        yield _picture(scene, case, renderer, boxes_that_differ(case.boxes_px))


def _picture(scene: Scene, case: VesselDifference, renderer: IdRenderer, styles: Styles) -> Figure:
    caption = describe_case(scene, case)
    return Figure(lambda: image(draw_case(scene, case, renderer, styles), caption), caption)


def _sides(box: BoxFigures) -> str:
    return _up_to(box.side_max_px, box.side_p99_px, 2, " px")


def _up_to(greatest: float, p99: float, digits: int, unit: str = "") -> str:
    return f"{greatest:.{digits}f}{unit} at most, {p99:.{digits}f}{unit} at the 99th percentile"


def _share(part: int, whole: int) -> str:
    return f"{part} ({in_percent(part / whole, 1)})" if whole else str(part)


def _provenance(
    comparison: SourceComparison, scene: Scene, renderer: IdRenderer, made_by: str, given: str | None
) -> Provenance:
    figures = comparison.figures
    note = "of the scene with the settings of the command, and every file that it names; a run of it has it in run.json"
    whole = Input("scene as compared", given or shown_path(Path(scene.path)), scene.sha256, note)
    files = dict.fromkeys(path for path in scene.copy.read if path.is_file())
    return Provenance(
        page="comparison of the sources of truth",
        made_by=made_by,
        inputs=(whole, *(_scene_file(scene, file) for file in files)),
        seeds=(("scene", str(scene.seed)),),
        options=(
            ("Steps", f"{figures.steps}, {figures.frames} frames compared"),
            ("Supersampling", str(figures.supersample)),
        ),
        made_before=(("Renderer", renderer.context.description),),
    )


def _scene_file(scene: Scene, file: Path) -> Input:
    folder = Path(scene.path).resolve().parent
    named = file.resolve()
    shown = named.relative_to(folder) if named.is_relative_to(folder) else Path(file.name)
    return Input("file of the scene", shown.as_posix(), sha256_of(file))


def _introduction(figures: ComparisonFigures) -> list[Text]:
    if figures.unexplained:
        answer = (
            f"{figures.unexplained} differences of the rendered truth from what was drawn, or from the analytic truth, "
            "are unexplained."
        )
    else:
        answer = (
            f"The rendered truth of {figures.vessel_frames} vessel-frames is what OpenGL draws, and pixel sampling "
            "explains every difference from the analytic truth."
        )
    method = (
        f"{figures.steps} steps, supersampling {figures.supersample}. OpenGL drew each vessel alone and with all else, "
        "in ID buffers with a depth test, by a projection and clipping of their own. The rendered source, which takes "
        "exact spans where it knows who is in front, must have the same pixels, counts, boxes and occluders. "
        "The analytic source cuts silhouette polygons by those in front of them; separating planes say which are in "
        "front. Where its boxes differ by more than a pixel, every pixel of the vessel was checked: it must be set if "
        "its centre is inside the exact region, and only then."
    )
    lead = Text(answer, "bad" if figures.unexplained else "lead", Where.TERMINAL)
    page = replace(lead, text=f"{'✗' if figures.unexplained else '✓'} {answer}", where=Where.PAGE)
    return [page, lead, Text(method, "soft", Where.PAGE)]


def draw_case(scene: Scene, case: VesselDifference, renderer: IdRenderer, styles: Styles) -> Image.Image:
    """A picture of a vessel with boxes of the sources and the pixels that differ."""
    solids = Solids.at(scene, scene.cameras[case.camera], case.step)
    outlines = solids.outlines
    (row,) = np.flatnonzero((outlines.occluder == case.vessel) & outlines.boxed)
    regions = visible_regions(outlines, solids.intrinsics)
    touching = np.concatenate([regions.order.first, regions.order.second])[np.tile(regions.order.intersecting, 2)]
    region = "region that a neighbour may hide" if row in touching else "exact region"
    return comparison_picture(case.boxes_px, case.vessel, solids, regions.visible[row], renderer, region, styles)


def describe_case(scene: Scene, case: VesselDifference) -> str:
    """Description of a case: which vessel it shows, when, from which camera, and why."""
    (time,) = scene.timestamps(case.step, case.step + 1)
    reason = f"{case.reason[:1].upper()}{case.reason[1:]}"
    return f"{scene.vessel_names[case.vessel]}, {scene.cameras[case.camera].name}, {time} s. {reason}"


@dataclass(frozen=True, eq=False, repr=False)
class TruthComparison(Result, SourceComparison):
    """Sources of the truth of a scene side by side, from `check_truth`: the `figures`, and the files `written`."""

    scene: Scene
    renderer: str  # the OpenGL in use
    written: tuple[Path, ...]

    def _document(self) -> Document:
        return document(self, self.scene)


def check_truth(
    scene: Scene | StrPath,
    out: StrPath | None = None,
    *,
    every: int = 1,
    overwrite: bool = False,
    progress: Callable[[int], None] = lambda steps: None,
    named: str | None = None,
    call: str | None = None,
) -> TruthComparison:
    """Check the rendered truth of a scene against ID buffers and geometry, and the idealised rectangle rule against it.

        modsim3d.check_truth("harbour", "compared", every=5).figures.unexplained

    Args:
        scene: A scene with the rendered source, its file, or the name of a shipped one.
        out: Folder for `compare.json` and `compare.html`; nothing is written if None.
        every: Take every K-th time step only.
        overwrite, progress, call: As those of `modsim3d.report`.
        named: Name of the scene on the page; its file if None.

    Raises:
        ModsimError: The scene is live, or is not rendered, there is no OpenGL, or the files cannot be written.
        TypeError: The scene is none, or a path is neither text nor a path.
    """
    check_every(every)
    scene = scene if isinstance(scene, Scene) else load_scene(scene, source="rendered")
    folder = None if out is None else as_path(out, "out", "a folder")
    paths, read = [] if folder is None else [folder / name for name in FILES], scene.copy.read
    with claimed(paths, overwrite=overwrite, inputs=read), open_renderer(scene) as renderer:
        if renderer is None:
            raise ModsimError("check truth needs the rendered source")
        comparison = compare_sources(scene, renderer, every=every, progress=progress)
        if folder is not None:
            rests_on = _provenance(
                comparison, scene, renderer, call or f"modsim3d.check_truth of {scene.name} from Python", named
            )
            contents: list[bytes | str] = [
                orjson.dumps(comparison.figures, option=orjson.OPT_INDENT_2) + b"\n",
                document_page(document(comparison, scene, renderer), rests_on),
            ]
            if worst := comparison.findings.rule.worst:
                contents.append(encoded(draw_case(scene, worst, renderer, RULE)))
            else:
                paths[-1].unlink(missing_ok=True)  # that of a comparison which is replaced
            write_files(dict(zip(paths, contents, strict=False)))
        written = tuple(path for path in paths if path.exists())  # a picture only where a vessel is occluded
        return TruthComparison(comparison.findings, comparison.figures, scene, renderer.context.description, written)
