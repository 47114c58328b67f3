"""Page of a learned detector."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np

from modsim3d.core.document import Block, BlockRow, Cell, Document, Figure, Heading, Items, Table, Text, Tiles, Where
from modsim3d.core.text import UNKNOWN, counted, in_percent, number, significant, with_interval
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS, stationary_shares
from modsim3d.learn.bootstrap import Column
from modsim3d.learn.box_errors import estimate
from modsim3d.learn.box_errors.laws import CELLS, ErrorMoments
from modsim3d.learn.figures import Curve, Figures, Ranking, Rates
from modsim3d.learn.learned_detector import LearnSettings, models_and_learners
from modsim3d.learn.report import LearnReport, data_sentence, how_well, lead, overlaps, results
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.pages import charts, page, provenance

# ---- What was learned, as tables ----

_RATES = ("precision", "recall", "F1", "FNR", "FDR")
_AVERAGE_PRECISIONS = ("AP, all points", "AP, 11 points", "AP, 101 points", "AUC")
_ERROR_COLUMNS = tuple(f"{name} {key}" for name in ("x", "y", "width", "height") for key in ("exp", "std"))


def _cell(column: Column, level: float, units: int, digits: int, *place: int) -> str:
    ends = (column.estimate, *column.interval(level, units))
    value, low, high = (float(np.asarray(end)[place]) for end in ends)
    return with_interval(value, low, high, digits)


def _row(figures: Figures, level: float, digits: int, columns: Sequence[Column], *place: int) -> list[str]:
    return [_cell(column, level, figures.units, digits, *place) for column in columns]


def tables(report: LearnReport) -> list[Table]:
    """All tables in the order of the thesis's chapter 8, which are too many for a terminal."""
    groups = [*report.conditions, *report.states] if report.states_differ else list(report.states)
    of_labels = groups if len(report.labelled.labels) > 1 else []
    errors = tuple((report.name(group), *_error_cells(report, group, group.errors)) for group in groups)
    title = "Correlation coefficients of the box errors"
    correlations = _by_pair(title, report, groups, lambda figures: figures.errors.correlation, 2, ERROR_PAIRS)
    title = "Covariances of the box errors in square pixels"
    covariances = _by_pair(title, report, groups, lambda figures: figures.error_covariance, 1, CELLS)
    used = tuple(matches.cells for matches in report.learned.numbers.box_errors.used)
    models = tuple(
        (part, name, "not learned" if learner is None else "learned") for part, name, learner in models_and_learners()
    )

    def detail(make: Callable[[LearnReport, Figures], Table], figures: Figures) -> Table:
        return replace(make(report, figures), where=Where.TEXT if figures in report.states else Where.PAGE)

    return [
        *([_state_table(report)] if report.states_differ else []),
        _rates(report, groups),
        Table("Box errors in pixels: expected value and standard deviation", ("condition", *_ERROR_COLUMNS), errors),
        correlations,
        Table(estimate.TITLE, estimate.HEADER, used),
        replace(covariances, where=Where.PAGE),
        *_curves(report, groups),
        *(detail(_labels, group) for group in of_labels),
        *(replace(_label_errors(report, group), where=Where.PAGE) for group in of_labels),
        *(detail(_confusion, group) for group in groups),
        *(*_shares(report), _parameters(report), *_long_run(report)),
        Table("Models that can be learned", ("part", "model", "estimate"), models),
    ]


def _state_table(report: LearnReport) -> Table:
    f1 = {figures.name: float(figures.any_label.f1.estimate) for figures in report.conditions}
    rows = [
        (state, ", ".join(f"{name} ({f1[name]:.3f})" if name in f1 else name for name in names))
        for state, names in report.state_map.states.items()
    ]
    left = set(f1) - {name for names in report.state_map.states.values() for name in names}
    rows += [("in no state", ", ".join(f"{name} ({f1[name]:.3f})" for name in f1 if name in left))] if left else []
    return Table("Performance states, and their conditions with their F1", ("state", "conditions"), tuple(rows))


def _rates(report: LearnReport, groups: Sequence[Figures]) -> Table:
    rows = [(report.name(group), str(group.images), *_row(group, report.level, 3, group.any_label)) for group in groups]
    header = ("condition", "images", "precision", "recall", "F1", f"F-{report.beta:g}", "FNR", "FDR")
    title = "Precision, recall, F1, false negative and false discovery rate, whatever the label"
    return Table(title, header, rows, where=Where.EVERYWHERE)


def _labels(report: LearnReport, figures: Figures) -> Table:
    def cells(rates: Rates, *place: int) -> list[str]:
        return _row(figures, report.level, 3, (*rates[:3], *rates[4:]), *place)  # without F-beta

    of_labels, mean = figures.average_precision, figures.mean_average_precision
    rows = [
        (
            name,
            f"{figures.counts[:, place].sum():.0f}",
            *cells(figures.of_labels, place),
            *(_row(figures, report.level, 3, (of_labels.all_points,), place) if of_labels else ()),
        )
        for place, name in enumerate(report.labelled.labels)
    ]
    area = _row(figures, report.level, 3, (mean.all_points,)) if mean else []
    rows.append(("arithmetic mean", "", *cells(figures.mean), *area))
    rows.append(("weighted mean", "", *cells(figures.weighted), *("" for _ in area)))
    title = f"Labels in {report.name(figures)}: another label is a miss of one and a false one of the other"
    return Table(title, ("label", "annotations", *_RATES, *("AP" for _ in area)), rows)


def _error_cells(report: LearnReport, figures: Figures, moments: ErrorMoments) -> list[str]:
    return [cell for k in range(4) for cell in _row(figures, report.level, 1, (moments.mean, moments.std), k)]


def _by_pair(
    title: str,
    report: LearnReport,
    groups: Sequence[Figures],
    column: Callable[[Figures], Column],
    digits: int,
    pairs: Sequence[tuple[int, int]],
) -> Table:
    """A row for each group, a column for each pair of components of the box error."""
    rows = [
        (report.name(group), *(_cell(column(group), report.level, group.units, digits, k) for k in range(len(pairs))))
        for group in groups
    ]
    return Table(title, ("condition", *(f"{ERROR_COMPONENTS[i]}, {ERROR_COMPONENTS[j]}" for i, j in pairs)), rows)


def _label_errors(report: LearnReport, figures: Figures) -> Table:
    rows = tuple(
        (name, *_error_cells(report, figures, moments))
        for name, moments in zip(report.labelled.labels, figures.errors_of_labels, strict=True)
    )
    title = f"Box errors in pixels by what was there, in {report.name(figures)}"
    return Table(title, ("label", *_ERROR_COLUMNS), rows)


def _curves(report: LearnReport, groups: Sequence[Figures]) -> list[Table]:
    """The table of average precision; none without confidences."""
    rows = []
    for figures in groups:
        if figures.mean_average_precision is None or figures.confidence_entropy is None:
            return []
        entropies = [figures.confidence_entropy, *([figures.label_entropy] if figures.label_entropy else [])]
        columns = [*figures.mean_average_precision, *entropies]
        rows.append((report.name(figures), *_row(figures, report.level, 3, columns)))
    extra = ("confidence cross-entropy", *(("label cross-entropy",) if groups[0].label_entropy else ()))
    title = f"Mean average precision over labels, every detection counted, matched by {report.curves_matched_by}"
    return [Table(title, ("condition", *_AVERAGE_PRECISIONS, *extra), tuple(rows))]


def _confusion(report: LearnReport, figures: Figures) -> Table:
    """The confusion matrix with its probabilities: the darker, the larger."""
    names, k = report.labelled.labels, len(report.labelled.labels)

    def cell(column: Column, row: int, true: int, *place: int) -> Cell:
        text = f"{figures.counts[row, true]:.0f}  {_cell(column, report.level, figures.units, 3, *place)}"
        return Cell(text, float(np.nan_to_num(np.asarray(column.estimate)[place])))

    rows = [
        (
            name,
            *(cell(figures.confusion, row, true, row, true) for true in range(k)),
            cell(figures.false_labels, row, k, row) if row < k else "",  # nothing taken for nothing is no number
        )
        for row, name in enumerate([*names, "missed"])
    ]
    title = f"Confusion matrix of {report.name(figures)}: detected as, by what was there; counts and probabilities"
    return Table(title, ("", *names, "background"), rows)


def _shares(report: LearnReport) -> list[Table]:
    """The table of what average precision is lost to; none without confidences."""
    if report.shares is None:
        return []
    rows = tuple((share.kind.value, str(share.count), f"{share.gain_points:.2f}") for share in report.shares.shares)
    points = f"{100 * report.shares.average_precision:.1f} points"
    title = f"What mean average precision, {points}, is lost to, matched by {report.curves_matched_by}"
    return [Table(title, ("error", "number", "points gained if corrected"), rows)]


def _parameters(report: LearnReport) -> Table:
    intervals = [entry for entry in report.learned.intervals(report.level) if not entry.key.own_table]
    rows = []
    for entry in sorted(intervals, key=lambda entry: (entry.key.state is not None, entry.key.path)):
        for place in np.ndindex(*entry.estimate.shape):
            value, low, high = (float(np.asarray(ends)[place]) for ends in (entry.estimate, entry.low, entry.high))
            finite = np.isfinite([value, low, high]).all()
            ends = f"{significant(low)} to {significant(high)}"
            interval = ends if finite else "not known" if np.isnan(low) else UNKNOWN
            rows.append((entry.key.at(place), significant(value), interval))
    header = ("number", "learned", f"{in_percent(report.level)} interval")
    return Table("Numbers of the detector file", header, tuple(rows))


def _long_run(report: LearnReport) -> list[Table]:
    """The table of the chain's stationary shares; none without a chain."""
    transitions, states = report.learned.transitions, report.learned.observed.states
    if not transitions.observed or len(states) == 1:
        return []
    shares = stationary_shares(transitions.matrix)  # every state follows every other, so there are such
    rows = tuple((state, in_percent(share, 1)) for state, share in zip(states, shares, strict=True))
    return [Table("States in the long run, by the learned transition matrix", ("state", "share of time"), rows)]


NEVER_LEARNED = (
    "Never learned: gates, which are hard limits, and confidence as a precision-recall curve. Persistence, what "
    "vessels keep, slopes of confidence, second boxes, merges and splits are not in the table of models; they are "
    "learned where the data show them."
)


# ---- What a detector was learned from, for the page of what was learned ----

_IMAGES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp"})  # of an image only its size is read


@dataclass(frozen=True, eq=False)
class Sources:
    """Files and runs that were learned from."""

    truth: tuple[Path, ...]  # as given: a file or a folder for each condition
    detections: tuple[Path, ...]  # the results on each
    runs: tuple[StoredRun, ...]  # in place of both, or beside them
    read: tuple[Path, ...]  # every file that was opened, also those that are not named, such as `data.yaml`
    settings: LearnSettings
    made_by: str  # the command, or the call from Python

    @property
    def names(self) -> tuple[str, ...]:
        """The labelled sets and the runs, as they were given."""
        return tuple(str(path) for path in (*self.truth, *(run.folder for run in self.runs)))

    @property
    def inputs(self) -> tuple[provenance.Input, ...]:
        """All files with their checksums. Raises InputError where a file cannot be read."""
        return (*self._files(), *(file for run in self.runs for file in provenance.run_inputs(run)))

    @property
    def seeds(self) -> tuple[tuple[str, str], ...]:
        """The seed of the bootstrap, and those of the runs."""
        of_runs = ((f"{name} of {run.folder}", seed) for run in self.runs for name, seed in provenance.run_seeds(run))
        return ("bootstrap", str(self.settings.seed)), *of_runs

    @property
    def made_before(self) -> tuple[tuple[str, str], ...]:
        """Versions by which the runs were made."""
        return tuple(dict.fromkeys(version for run in self.runs for version in provenance.run_versions(run)))

    def _files(self) -> Iterator[provenance.Input]:
        files_of, rest = self._sorted()
        for place, pair in enumerate(zip(self.truth, self.detections, strict=True)):
            number = f" {place + 1}" if len(self.truth) > 1 else ""
            for what, given in zip((f"ground truth{number}", f"detections{number}"), pair, strict=True):
                if given.is_dir():
                    yield provenance.folder_input(what, given, files_of.get(given.absolute(), []))
                else:
                    yield provenance.file_input(what, given)
        yield from (provenance.file_input("also read", path) for path in rest)

    def _sorted(self) -> tuple[dict[Path, list[Path]], list[Path]]:
        """The files read, by the innermost given path that they lie in, absolute, and of none; a run's with it."""
        given = {path.absolute() for path in (*self.truth, *self.detections)}
        runs = [run.folder.resolve() for run in self.runs]
        files: dict[Path, list[Path]] = {}
        rest: list[Path] = []
        for path in dict.fromkeys(self.read):
            if not path.is_file() or path.suffix.lower() in _IMAGES:
                continue
            whole = path.absolute()
            owner = next((parent for parent in (whole, *whole.parents) if parent in given), None)
            if owner is not None:
                files.setdefault(owner, []).append(whole)
            elif not (runs and any(path.resolve().is_relative_to(run) for run in runs)):
                rest.append(path)
        return files, rest


def document(
    report: LearnReport, name: str = "detector", sources: Sequence[str] = (), sections: Sequence[Block] = ()
) -> Document:
    """Document of what was learned. `name` is that of the detector file, `sources` are the labelled sets as given,
    `sections` come before the figures."""
    near_gate = [report.near_gate.remark] if report.near_gate.shares else []
    cautions = [*report.remarks_on_unknown, *report.remarks_on_check, *report.remarks_on_data, *near_gate]
    return Document(
        f"{name}: a detector learned from {counted(len(report.labelled.images), 'image')}",
        [
            Text(data_sentence(report, name, sources), "lead"),
            Text(how_well(report)),
            Text(f"IoU of the matches: {overlaps(report)}."),
            Text(f"Warning: {report.warning}." if report.warning else "", "bad", Where.EVERYWHERE & ~Where.TERMINAL),
        ],
        [
            Tiles(results(report)),
            Text(lead(report), "soft", Where.EVERYWHERE),
            Heading("Read the numbers with this"),
            Items([f"{caution}." for caution in cautions], Where.EVERYWHERE),
            *sections,
            *_curve_charts(report),
            Heading("Box errors"),
            BlockRow(list(_scatters(report))),
            *_share_chart(report),
            *_reality(report),
            Heading("Figures"),
            *tables(report),
            Heading("Left simple"),
            Items(report.learned.notes or ["nothing: there was enough of everything"]),
            Text(NEVER_LEARNED),
            Text(_POINTS if report.shares else "", "soft", Where.PAGE),
        ],
    )


def page_text(report: LearnReport, out: Path, detector: str, sources: Sources, sections: Sequence[Block] = ()) -> str:
    """The page, in one file, given the detector file, its content and what it was learned from."""
    body = document(report, out.name, sources.names, sections)
    return page.document_page(body, _provenance(report, out, detector, sources))


def _provenance(report: LearnReport, out: Path, detector: str, sources: Sources) -> provenance.Provenance:
    settings, checksum = sources.settings, sha256(detector.encode()).hexdigest()
    states = "; ".join(f"{name} = {', '.join(names)}" for name, names in report.state_map.states.items())
    written = provenance.Input("detector file that was learned", out.name, checksum, "as written")
    return provenance.Provenance(
        page="a detector learned from its results on labelled images",
        made_by=sources.made_by,
        inputs=(written, *sources.inputs),
        seeds=sources.seeds,
        options=(
            ("Matched by", report.matched_by),
            ("Least confidence", f"{settings.threshold:g}" if report.labelled.scored else "none: not given"),
            ("Intervals", f"{in_percent(report.level)}, {settings.replicates:,} replicates of the bootstrap"),
            ("States", states),
        ),
        made_before=sources.made_before,
    )


_SHARES = (
    "Points of mean average precision that correcting one kind of error would gain (Bolya et al., 2020): "
    "classification, localisation, both, duplicate, background, missed."
)
_POINTS = (
    "Average precision: by all points it is the area under the interpolated curve; COCO's tools average that curve at "
    "101 levels of recall, and the 11-point form at 11, so the three differ by up to a step of the curve."
)


def _reality(report: LearnReport) -> list[Block]:
    """Real and simulated numbers where the detector was not learned."""
    rows = () if report.check is None else report.check.comparisons
    cells = [
        (row.name, *(number(value, 4) for value in (row.real, row.simulated, row.spread, row.p_value))) for row in rows
    ]
    note = (
        "Spread is the standard deviation over simulated seeds. The p-value is that of a real number from the same "
        "distribution, adjusted for the number of lines; below 0.05 the two differ. Above it no difference was found, "
        "which is no proof that there is none."
    )
    return [
        Heading("Where it was not learned"),
        Table("", ("", "real", "simulated", "spread", "p-value"), cells),
        Text(note if rows else "", "soft"),
    ]


def _curve_charts(report: LearnReport) -> list[Block]:
    if report.by_label is None:
        return []
    title = f"Precision against recall, matched by {report.curves_matched_by}"
    caption = "largest precision at each recall or beyond."
    labels = enumerate(report.labelled.labels)
    return [
        Heading(title),
        BlockRow([Figure(partial(_curve_chart, report, label), f"{name}: {caption}") for label, name in labels]),
    ]


def _curve_chart(report: LearnReport, label: int) -> str:
    states, of_state = report.learned.observed.states, {}
    colours = []
    for index, (state, colour) in enumerate(zip(states, charts.state_colours(len(states)), strict=True)):
        images = report.learned.observed.image_state == index
        assert report.by_label is not None
        curve: Curve | None = Ranking.of(report.labelled, report.by_label, label, images).curve()
        if curve is not None and len(curve.recall):
            of_state[f"{state}: AP {curve.all_points():.3f}"] = curve.recall, curve.interpolated
            colours.append(colour)
    return charts.precision_recall(of_state, colours)


def _scatters(report: LearnReport) -> Iterator[Block]:
    pairs, relative = report.learned.observed.pairs, report.learned.form.box_errors.relative
    error, state = pairs.errors(pairs.sure, relative), pairs.state[pairs.sure]  # in the unit in which they are learned
    states = report.learned.observed.states
    indices = [index for index in range(len(states)) if np.any(state == index)]
    colours = [charts.state_colours(len(states))[index] for index in indices]
    for (i, j), what in (((0, 1), "centres"), ((2, 3), "sizes")):
        groups = {states[index]: error[state == index][:, [i, j]] for index in indices}
        units = ("widths", "heights") if relative else ("px", "px")
        x, y = (f"{ERROR_COMPONENTS[k]} in {unit}" for k, unit in zip((i, j), units, strict=True))
        caption = f"Errors of {what}; ellipses hold 95 % of normal errors with the same mean and covariance."
        yield Figure(partial(charts.error_scatter, groups, colours, x, y), caption)


def _share_chart(report: LearnReport) -> list[Block]:
    if report.shares is None:
        return []
    gains = {share.kind.value: max(share.gain_points, 0.0) for share in report.shares.shares}
    title = "What average precision is lost to"
    return [Heading(title), Figure(partial(charts.named_bars, gains, "points", title), _SHARES)]
