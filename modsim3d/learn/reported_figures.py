"""A detector from the figures of a test report alone: rates, a confusion matrix, mean IoU, average precision."""

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import Overlaps, areas, corner_form, iou
from modsim3d.core.document import Block, Document, Heading, Items, Result, Table, Text, Where
from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.file.reading import detector_text, parse_detector
from modsim3d.detector.file.schema import Labels
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames, Targets, are_false
from modsim3d.formats.labelled import EVERYWHERE
from modsim3d.io.atomic_write import write_files
from modsim3d.io.overwrite_guard import claimed
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import NotNegative, Positive, Probability, Strict, describe, shown
from modsim3d.learn.bootstrap import columns_of_one, digits
from modsim3d.learn.figures import COCO_POINTS, Ranking

ROUNDING, NOTICEABLE = 0.005, 0.015
"""Half a unit of the last of two decimals, and a difference between two figures that is a contradiction."""
SIZES_PX = {"ap_small": (16, 32), "ap_medium": (32, 96), "ap_large": (96, 256)}
"""Root of the areas of boxes, as COCO divides them; the outer ends are those of the simulated boxes."""
WAYS = {"predicted": "matrix_rows: predicted (ultralytics)", "true": "matrix_rows: true (scikit-learn)"}


def _rate(value: Any) -> Any:
    """A share, or one for each label. Raises ValueError for anything else."""
    shares = list(value.values()) if isinstance(value, Mapping) else [value]
    if not all(isinstance(rate, int | float) and not isinstance(rate, bool) and 0 < rate <= 1 for rate in shares):
        raise ValueError(f"must be a share above 0 and up to 1, or one for each label (got {shown(value)})")
    return value


Rate = Annotated[Any, AfterValidator(_rate)]
Ap = Annotated[
    Probability | None, BeforeValidator(lambda value: None if value == -1 else value)
]  # COCO's for no object


class Report(Strict):
    """Figures of a test report, as docs/from_figures.md lists them; None is not known."""

    labels: Labels
    precision: Rate = None
    recall: Rate = None
    confusion_matrix: Annotated[list[list[NotNegative | None]], Field(min_length=1)] | None = None
    matrix_rows: Literal["true", "predicted"] | None = None
    annotations: dict[str, Positive] | None = None
    images: Annotated[int, Field(strict=True, gt=0)] | None = None
    confidence: Probability | None = None
    mean_iou: Probability | None = None
    map50: Probability | None = None
    map50_95: Probability | None = None
    ap_small: Ap = None
    ap_medium: Ap = None
    ap_large: Ap = None

    @classmethod
    def of(cls, content: Any, source: str) -> Self:
        """The report in a mapping. Raises InputError if a key is wrong."""
        if not isinstance(content, Mapping):
            raise InputError(source, [f"must be a mapping with the keys {', '.join(cls.model_fields)}"])
        try:
            report = cls.model_validate(dict(content))
        except ValidationError as error:
            raise InputError(source, describe(error, cls)) from None
        named = {key: getattr(report, key) for key in ("precision", "recall", "annotations")}
        problems = [
            f"{key}: must have a number for each of {', '.join(report.labels)} (got {', '.join(map(str, value))})"
            for key, value in named.items()
            if isinstance(value, Mapping) and set(value) != set(report.labels)
        ]
        if report.confusion_matrix is None and None in (report.precision, report.recall):
            problems.append("give precision and recall, or a confusion_matrix")
        if problems:
            raise InputError(source, problems)
        return report

    def of_labels(self, key: str) -> Array | None:
        """A figure of each label, shape (k,), the same for all if it is one number; None if it is not given."""
        value = getattr(self, key)
        if value is None:
            return None
        return np.array([value[name] if isinstance(value, Mapping) else value for name in self.labels], dtype=float)

    def matrix(self, source: str, assumed: list[str]) -> tuple[Array, bool]:
        """Confusion matrix, predicted labels down, true ones across, perhaps with background last, and whether of
        counts. Raises InputError if it can be read in no way, or in two."""
        given, k, where = self.confusion_matrix or [], len(self.labels), f"{source}: confusion_matrix"
        lengths = [len(given), *{len(row) for row in given}]
        if len(lengths) != 2 or not {*lengths} <= {k, k + 1}:
            got = f"{len(given)} rows of {' and '.join(map(str, lengths[1:]))}"
            raise InputError(where, [f"must have {k} or, with background, {k + 1} rows and columns (got {got})"])
        cells = np.array([[cell or 0.0 for cell in row] for row in given])
        counts = bool(np.all(cells == np.round(cells)) and cells.max() > 1)
        if not counts and cells.max() > 1:
            part = f"{np.max(cells[cells != np.round(cells)]):g} is no count, and {cells.max():g} is no share"
            raise InputError(where, [f"must have counts, or shares from 0 to 1, and not both ({part})"])
        ways = {"predicted": cells, "true": cells.T}
        problems = {way: self._matrix_problem(matrix, counts) for way, matrix in ways.items()}
        possible = [way for way, problem in problems.items() if not problem]
        way = self.matrix_rows or (possible or ["none"])[0]
        if way not in possible:
            hints = [f"{WAYS[other]} would fit" for other in possible]
            raise InputError(where, [problems[way], *hints] if way in problems else sorted(set(problems.values())))
        if self.matrix_rows is None and len(possible) == 2 and not np.array_equal(ways["true"], ways["predicted"]):
            raise InputError(where, [f"are its rows true or predicted labels? Give {' or '.join(WAYS.values())}"])
        assumed += [] if self.matrix_rows else [f"The rows of the confusion matrix are {way} labels."]
        return ways[way], counts

    def _matrix_problem(self, cells: Array, counts: bool) -> str:
        """Reason why the columns of a matrix cannot be true labels; empty if they can."""
        numbers, whole = self.of_labels("annotations"), len(cells) > len(self.labels)
        slack = ROUNDING * max(len(cells), 2) + 1e-9
        for place, (name, total) in enumerate(zip(self.labels, cells.sum(axis=0), strict=False)):
            if counts and (total == 0 or (whole and numbers is not None and total != numbers[place])):
                wanted = "more than 0" if numbers is None else f"{numbers[place]:g}, as in annotations"
                return f"counts of the true label '{name}' sum to {total:g}, must to {wanted}"
            if not counts and abs(total - 1) > slack:
                rounded = f"two decimals allow {1 - slack:.3f} to {1 + slack:.3f}"
                return f"shares of the true label '{name}' sum to {total:.4g}, must sum to 1 ({rounded})"
        return ""


def _cells(report: Report, source: str, assumed: list[str], contradictions: list[str]) -> tuple[Array, float | None]:
    """Confusion matrix as shares of all annotations, predicted labels down, true ones across, background last in both,
    shape (k + 1, k + 1), and the number of annotations in an image, None if it is not known. Raises InputError if the
    report does not state enough."""
    k, precision, recall = len(report.labels), report.of_labels("precision"), report.of_labels("recall")
    given, counts = (np.eye(k), False) if report.confusion_matrix is None else report.matrix(source, assumed)
    true, false, numbers = given[:, :k], given[:k, k:].sum(axis=1), report.of_labels("annotations")
    numbers = true.sum(axis=0) if counts and (len(true) > k or numbers is None) else numbers
    if numbers is None and k > 1:
        assumed.append("All labels are equally frequent; annotations would say.")
    share, true = np.full(k, 1 / k) if numbers is None else numbers / numbers.sum(), true / true.sum(axis=0)
    if len(true) > k:
        _compare(report, "recall", np.diag(true), contradictions)
    elif recall is None:
        raise InputError(source, ["recall: missing: the matrix has no background, so it does not say what is missed"])
    else:
        if report.confusion_matrix is None and k > 1:
            assumed.append("No vessel is taken for another label; a confusion_matrix would say.")
        hits = recall / np.maximum(np.diag(true), 1e-12)
        if np.any(hits > 1 + NOTICEABLE):
            contradictions.append("recall is higher than the share of right labels in the matrix: nothing is missed")
        true = np.vstack([true * np.minimum(hits, 1), 1 - np.minimum(hits, 1)])
    true = true * share
    right, hits = np.diag(true), true[:k].sum(axis=1)
    if counts and numbers is not None and given.shape == (k + 1, k + 1):
        false = false / numbers.sum()
        _compare(report, "precision", right / np.maximum(hits + false, 1e-12), contradictions)
    elif precision is None:
        raise InputError(source, ["precision: missing: the matrix does not say how many detections are false"])
    else:
        by_label = isinstance(report.precision, Mapping)
        excess = right / precision - hits
        total = excess.sum() if by_label else right.sum() / precision[0] - hits.sum()
        if total < -NOTICEABLE:
            contradictions.append("precision is higher than confusions of labels allow: nothing else is false")
        if not false.sum():
            false = np.maximum(excess, 0) if by_label and excess.max() > 0 else share
            assumed += ["Labels of false positives follow precision and annotations."] if k > 1 else []
        false = false / false.sum() * max(total, 0)
    per_image = None if numbers is None or report.images is None else float(numbers.sum()) / report.images
    return np.column_stack([true, [*false, 0]]), per_image


def _compare(report: Report, key: str, of_matrix: Array, contradictions: list[str]) -> None:
    """Note where a figure of the report, of each label or their mean, is not that of its matrix, shape (k,)."""
    reported, names = report.of_labels(key), [f" of {name}" for name in report.labels]
    if not isinstance(getattr(report, key), Mapping):
        of_matrix, names = of_matrix.mean(keepdims=True), [""]
    for name, value, by_matrix in zip(names, [] if reported is None else reported, of_matrix, strict=False):
        if abs(value - by_matrix) > NOTICEABLE:
            contradictions.append(f"{key}{name} is {value:.3g}, and {by_matrix:.3g} by the matrix, which counts")


# ---- Figures that a detector gives back, from simulated boxes without images ----

IMAGES, VESSELS, IMAGE_PX = 800, 10, (1920, 1080)
THRESHOLDS = np.arange(0.5, 0.96, 0.05)


@dataclass(frozen=True, eq=False)
class Sample:
    """A test set in place of one that nobody has: boxes of all sizes, anywhere in the image."""

    frames: CameraFrames
    targets: Targets

    @classmethod
    def of(cls, share: Array) -> Self:
        """Vessels of k labels, of which each has a share, shape (k,)."""
        draw, count, images = np.random.default_rng(0), IMAGES * VESSELS, np.arange(IMAGES)
        side, aspect = 16 * 16 ** draw.random(count), 4 ** draw.random(count)
        size = side[:, None] * np.column_stack([aspect**0.5, aspect**-0.5])
        centre = size / 2 + draw.random((count, 2)) * (np.array(IMAGE_PX) - size)
        label = np.searchsorted(np.cumsum(share), (draw.permutation(count) + 0.5) / count)
        half_planes, names = np.tile(EVERYWHERE, (IMAGES, 1)), tuple(map(str, range(VESSELS)))
        boxes_px, ones = corner_form(np.column_stack([centre, size])), np.ones(count)
        return cls(
            CameraFrames("test set", images, images.astype(np.float64), IMAGE_PX, half_planes),
            Targets(images.repeat(VESSELS), np.tile(np.arange(VESSELS), IMAGES), label, boxes_px, ones, ones, names),
        )

    def figures(self, model: DetectorModel) -> dict[str, float]:
        """Figures of a detector: a box is right if it has its vessel's label and IoU of at least 0.5."""
        statistics, truth = target_statistics(model, [(self.frames, self.targets)]), self.targets
        detector = Detector(model, 0, statistics, lambda first, stop: self.frames.times_s[first:stop])
        detections = detector.detect(self.frames, truth)
        true, overlap = ~are_false(detections.kind), np.full(len(detections), -1.0)
        overlap[true] = iou(detections.boxes_px[true], truth.boxes_px[detections.target[true]])
        own = true & (truth.label[detections.target] == detections.label)
        truth_px = np.sqrt(areas(truth.boxes_px))
        found_px = np.where(true, truth_px[detections.target], np.sqrt(areas(detections.boxes_px)))
        right, order = own & (overlap >= 0.5), np.argsort(-detections.confidence, kind="stable")

        def precision(least_iou: float, low: float = 0.0, high: float = np.inf) -> float:
            """Mean average precision over labels, of vessels and boxes of some sizes."""
            scores = []
            for label in np.unique(truth.label):
                rows = order[((detections.label == label) & (found_px >= low) & (found_px < high))[order]]
                sought = truth.frame[(truth.label == label) & (truth_px >= low) & (truth_px < high)]
                good = own[rows] & (overlap[rows] >= least_iou)
                curve = Ranking(detections.frame[rows], good, detections.confidence[rows], sought).curve()
                scores.append(0.0 if curve is None else curve.at_points(COCO_POINTS))
            return float(np.mean(scores))

        mean, median, below = Overlaps.of(overlap[true])
        figures = {"precision": right.sum() / max(len(detections), 1), "recall": right.sum() / len(truth)}
        figures |= {"mean_iou": mean, "median_iou": median, "iou_below_half": below, "map50": precision(0.5)}
        sizes = {"map50_95": (0.0, np.inf), **SIZES_PX}
        figures |= {name: np.mean([precision(u, *ends) for u in THRESHOLDS]) for name, ends in sizes.items()}
        return {name: float(value) for name, value in figures.items()}


# ---- A detector that gives the figures back ----

ASSUMED = (
    "Misses, boxes and confidences are new in each frame, which a real detector's are not: see persistence.",
    "Each edge of a box is off by itself, in proportion to the box, and by 0 on average.",
    "False positives lie anywhere below the horizon, are as large as vessels, and last one frame.",
)


def _content(
    report: Report, cells: Array, spread: float, sharpness: float, below: float, per_image: float | None = None
) -> dict[str, Any]:
    """The keys of a detector file from a matrix of `_cells`. `spread` is the standard deviation of e_x and e_y in sides
    of the box, `sharpness` the exponent with which precision falls, `below` the share of boxes with IoU below 0.5,
    which a report counts as missed and false, `per_image` the number of annotations in an image, if it is known."""
    share = cells[:, :-1].sum(axis=0)
    confusion = cells[:-1, :-1] / (share * (1 - below))
    confusion = confusion / np.maximum(confusion.sum(axis=0), 1)
    detected = float(confusion.sum(axis=0) @ share)
    false = max(float(cells[:-1].sum()) - detected, 0.0)
    discovery = min(false / (detected + false), 0.99)
    recall = np.linspace(0, 1, 9)[1:]
    curve = zip(detected * recall, 1 - discovery * recall**sharpness, strict=True)
    state: dict[str, Any] = {
        "confusion": columns_of_one(np.vstack([confusion, 1 - confusion.sum(axis=0)])),
        "false_positive_labels": columns_of_one(cells[:-1, -1] if cells[:-1, -1].sum() else share),
        **({"false_discovery_rate": digits(discovery)} if per_image is None else {}),
        "box_error": {"unit": "relative", "std": [digits(spread * factor) for factor in (1, 1, 2, 2)]},
        "confidence": {"precision_recall": [[digits(value) for value in point] for point in curve]},
    }
    rate = {} if per_image is None else {"rate": digits(false * per_image)}
    return {
        "labels": list(report.labels),
        "confidence_threshold": 0.25 if report.confidence is None else report.confidence,
        "initial_state": "reported",
        "transition_matrix": [[1]],
        **_dropout(report, detected),
        "false_positives": {"model": "per_image" if rate else "calibrated", **rate},
        "states": {"reported": state},
    }


def _dropout(report: Report, share: float) -> dict[str, Any]:
    """Misses that follow size, with recall in proportion to average precision; empty unless two sizes are given."""
    ends = {name: size for name, size in SIZES_PX.items() if getattr(report, name) is not None}
    if len(ends) < 2:
        return {}
    precision = np.array([getattr(report, name) for name in ends])
    recall = np.clip(share * precision / max(precision.mean(), 1e-12), 0.02, 0.98)
    octaves = [np.log2(low * high) / 2 for low, high in ends.values()]
    effect = {"per_doubling": digits(np.polyfit(octaves, np.log((1 - recall) / recall), 1)[0]), "reference": 64}
    return {"dropout": {"model": "logistic", "anchor": "state_rate", "size_px": effect}}


def _solved(figure: Callable[[float], float], wanted: float, low: float, high: float) -> float:
    """The place where a figure that falls from `low` to `high` has a value, or the nearest end."""
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (middle, high) if figure(middle) > wanted else (low, middle)
    return (low + high) / 2


@dataclass(frozen=True, eq=False, repr=False)
class ReportedDetector(Result):
    """A detector made from a test report, from `learn_from_figures`.

        made = modsim3d.learn_from_figures({"labels": ["boat"], "precision": 0.9, "recall": 0.8})
        made.assumed, made.write("detector.yaml")

    Attributes:
        content: The keys of its detector file.
        figures: Each figure as in the report, None where it has none, and as simulated.
        assumed: What the report does not say.
        contradictions: Figures of the report that contradict each other.
        source: The report, and its file.
    """

    content: dict[str, Any]
    figures: Mapping[str, tuple[float | None, float]]
    assumed: tuple[str, ...]
    contradictions: tuple[str, ...]
    source: tuple[str, *tuple[Path, ...]]

    @property
    def detector(self) -> DetectorModel:
        """The detector, as `load_detector` would read it from its file."""
        return parse_detector(self.content, "detector of a report")

    def document(self, name: str = "detector") -> Document:
        """The figures that it gives back, what was assumed, and contradictions."""
        figures = [(key, "" if a is None else f"{a:.3f}", f"{b:.3f}") for key, (a, b) in self.figures.items()]
        blocks: list[Block] = [
            Table("Figures", ("", "report", "simulated"), figures, where=Where.EVERYWHERE),
            Heading("Assumed, since the report does not say"),
            Items(self.assumed, Where.EVERYWHERE),
        ]
        return Document(name, [Text(f"{name}: a detector from the figures of {self.source[0]}.", "lead")], blocks)

    _document = document

    def write(self, path: StrPath, *, overwrite: bool = False) -> Path:
        """Write the detector file, in which comments name all that was assumed, and return its path.

        Raises:
            OutputError: A file exists without `overwrite`, is the report, or cannot be written.
            TypeError: The path is neither text nor a path.
        """
        simulated = ", ".join(f"{name} {value:.3f}" for name, (_, value) in self.figures.items())
        notes = [f"Made by modsim3d learn --from-figures of {self.source[0]}. When simulated: {simulated}."]
        notes += [f"Assumed: {text}" for text in self.assumed] + [f"Contradiction: {x}." for x in self.contradictions]
        out, lines = as_path(path, "path"), [line for note in notes for line in textwrap.wrap(note, 110)]
        with claimed([out], overwrite=overwrite, inputs=self.source[1:]):
            write_files({out: detector_text(self.content, lines)})
        return out


def learn_from_figures(report: StrPath | Mapping[str, Any]) -> ReportedDetector:
    """Make a detector from the figures of a test report, where results on images are not at hand.

        made = modsim3d.learn_from_figures({"labels": ["boat"], "precision": 0.91, "recall": 0.84, "mean_iou": 0.8})
        made.write("detector.yaml")

    Args:
        report: A YAML file, or a mapping with its keys, which docs/from_figures.md lists.

    Raises:
        ModsimError: The file cannot be read, or the figures do not suffice or cannot be.
        TypeError: It is neither a mapping nor a path.
    """
    if isinstance(report, Mapping):
        return _detector(report, "report")
    path = as_path(report, "report", "a mapping or a path")
    return _detector(load_yaml(path, "report"), f"report {path}", path)


def _detector(content: Any, source: str, *inputs: Path) -> ReportedDetector:
    """The detector of a report, with its box errors and confidences solved for."""
    report, assumed, contradictions = Report.of(content, source), list[str](), list[str]()
    cells, per_image = _cells(report, source, assumed, contradictions)
    sample, assumed = Sample.of(cells[:, :-1].sum(axis=0)), [*assumed, *ASSUMED]

    def figures(spread: float, sharpness: float = 1.0, below: float = 0.0) -> dict[str, float]:
        return sample.figures(parse_detector(_content(report, cells, spread, sharpness, below), source))

    if (report.map50_95 or 0) > (report.map50 or 1):
        contradictions.append("map50_95 is higher than map50, though AP falls as the least IoU rises")
    by_ratio = report.mean_iou is None and bool(report.map50 and report.map50_95)
    wanted = (report.map50_95 or 0) / (report.map50 or 1) if by_ratio else report.mean_iou or 0.8
    if report.mean_iou is None and not by_ratio:
        assumed.append("Mean IoU is 0.8; mean_iou, or map50 and map50_95, would say.")

    def overlap(spread: float) -> float:
        numbers = figures(spread)
        return numbers["map50_95"] / numbers["map50"] if by_ratio else numbers["mean_iou"]

    spread = _solved(overlap, wanted, 0.0, 0.5)
    below, sharpness, wanted = figures(spread)["iou_below_half"], 1.0, -(report.map50 or 0)
    if report.map50 is None:
        assumed.append("Precision falls evenly as the threshold does; map50 would say how.")
    else:
        sharpness = 2 ** _solved(lambda log: -figures(spread, 2**log, below)["map50"], wanted, -6, 6)
    if any(getattr(report, name) is not None for name in SIZES_PX):
        assumed.append("Recall follows size as ap_small, ap_medium and ap_large do, of which it takes the ratios.")
    if report.confidence is None:
        assumed.append("All was measured at confidence 0.25; confidence would say.")
    simulated, right = figures(spread, sharpness, below), float(np.trace(cells))
    asked = {key: getattr(report, key, None) for key in simulated}
    asked |= {"precision": right / float(cells[:-1].sum()), "recall": right}
    for key, value in asked.items():
        if value is not None and key not in SIZES_PX and abs(value - simulated[key]) > 2 * NOTICEABLE:
            why = ": it also counts detections below the threshold, which the file has none of" * key.startswith("map")
            contradictions.append(f"{key} is {value:.3g}, and {simulated[key]:.3g} with the other figures{why}")
    return ReportedDetector(
        _content(report, cells, spread, sharpness, below, per_image),
        {key: (asked[key], value) for key, value in simulated.items()},
        tuple(assumed),
        tuple(contradictions),
        (source, *inputs),
    )
