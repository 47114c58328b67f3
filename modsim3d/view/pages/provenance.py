"""Provenance of a page, so that it can be signed: command, versions, seeds, and every input with its checksum."""

import hashlib
import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from modsim3d.core.errors import InputError
from modsim3d.core.text import UNKNOWN, counted
from modsim3d.io.input_files import data_folder, file_sha256
from modsim3d.io.plugins import installed_version
from modsim3d.runs.files.block_files import KEPT_TRUTH, SETTINGS_FILE
from modsim3d.runs.files.overwrite import RUN_FILE, SCENE_FOLDER, UNFINISHED
from modsim3d.runs.run import VERSIONED
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.pages.tables import breaking

ANCHOR = "rests-on"
_SHORT = 12  # digits of a checksum in the line at the top; the block at the end has all
_NAMES = {"numpy": "NumPy", "scipy": "SciPy", "shapely": "Shapely", "pyarrow": "PyArrow"}
SIGNED = ("Name", "Date", "Signature")


@dataclass(frozen=True)
class Input:
    """Something that a page was made from."""

    what: str  # such as `detector file`
    path: str  # as the user gave it; a name if it was no file
    sha256: str | None  # in hexadecimal digits; None if it has none, as what was given in memory
    note: str = ""  # what else must be known of it
    bad: bool = False  # whether the note says that something is wrong


@dataclass(frozen=True)
class Provenance:
    """Provenance of a page. It has no times and no names of machines, so the same input gives the same bytes."""

    page: str  # what kind of page it is
    made_by: str  # the command in its normal form, or the call from Python
    inputs: tuple[Input, ...]  # what it was made from, the most important first
    seeds: tuple[tuple[str, str], ...] = ()  # each with its name
    options: tuple[tuple[str, str], ...] = ()  # what else decides the content, each with its name
    made_before: tuple[tuple[str, str], ...] = ()  # a name, such as `The run`, and by which versions it was made


def installed() -> dict[str, str]:
    """The versions of the packages that decide results, by their names."""
    return {name: installed_version(name) for name in VERSIONED}


def versions_in_words(versions: Mapping[str, str]) -> str:
    """Packages with their versions, in a line."""
    return ", ".join(f"{_NAMES.get(name, name)} {number}" for name, number in versions.items())


def sha256_of(path: Path) -> str:
    """The checksum of a file, as `sha256sum` prints it. Raises InputError if the file cannot be read."""
    try:
        return file_sha256(path)
    except OSError as error:
        raise InputError(str(path), [f"cannot be read for its checksum: {error.strerror or error}"]) from None


def file_input(what: str, path: Path, note: str = "") -> Input:
    """A file, by its path as it was given; one that ships with modsim3d by its place there."""
    return Input(what, shown_path(path), sha256_of(path), note)


def shown_path(path: Path) -> str:
    """A path as it was given; that of a file that ships with modsim3d, which is another on each machine, from there."""
    shipped = data_folder("scenes")
    return f"shipped {path.relative_to(shipped.parent)}" if path.is_relative_to(shipped) else str(path)


def folder_input(what: str, folder: Path, files: Iterable[Path]) -> Input:
    """Several files inside a folder, which is shown as it was given, as one input.
    Their checksum is that of the lines that `sha256sum` prints for them in that folder, sorted by path."""
    inside = folder.absolute()
    names = sorted({path.absolute().relative_to(inside).as_posix(): path for path in files}.items())
    lines = "".join(f"{sha256_of(path)}  {name}\n" for name, path in names)
    digest = hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()
    return Input(what, str(folder), digest, f"of the sha256sum lines of {counted(len(names), 'file')}, sorted by path")


def provenance(basis: Provenance) -> str:
    """The block of a page that says what it rests on, with lines for a signature in print."""
    facts = [
        ("Page", html.escape(basis.page)),
        ("Made by", f"<code>{html.escape(basis.made_by)}</code>"),
        ("Made with", html.escape(versions_in_words(installed()))),
        *((name, html.escape(text)) for name, text in basis.made_before),
        *((f"Seed: {name}", html.escape(value)) for name, value in basis.seeds),
        *((name, html.escape(value)) for name, value in basis.options),
    ]
    lines = "\n".join(f"<tr><th>{html.escape(name)}</th><td>{text}</td></tr>" for name, text in facts)
    signed = "".join(f"<div><span>{name}</span></div>" for name in SIGNED)
    return (
        f'<section class="rests-on" id="{ANCHOR}">\n<h2>What this page rests on</h2>\n'
        f'<table class="facts">\n{lines}\n</table>\n{_inputs(basis.inputs)}\n'
        '<p class="soft">The same inputs, command and versions give the same bytes. The command is shown without the '
        "options that only say where files go or what is printed.</p>\n"
        '<div class="signature in-print"><p class="soft">The mark at the foot of each sheet is from the checksum of '
        f'the page: sheets of one page share it.</p><div class="lines">{signed}</div></div>\n</section>'
    )


def top_line(basis: Provenance) -> str:
    """The line under a page's title, which leads to the block, and what is wrong with an input."""
    first = [f"{Path(file.path).name} ({file.sha256[:_SHORT]})" for file in basis.inputs[:2] if file.sha256]
    seeds = [f"seeds: {', '.join(f'{name} {value}' for name, value in basis.seeds)}"] if basis.seeds else []
    in_short = html.escape(" · ".join([*first, *seeds, f"modsim3d {installed_version('modsim3d')}"]))
    line = f'<div class="soft top-line">{in_short} · <a href="#{ANCHOR}">what this page rests on</a></div>'
    wrong = (f'<p class="bad">{html.escape(f"{file.path}: {file.note}")}.</p>' for file in basis.inputs if file.bad)
    return "\n".join([line, *wrong])


def _inputs(inputs: Sequence[Input]) -> str:
    lines = []
    for file in inputs:
        kind = "bad" if file.bad else "soft"
        note = f'<br><span class="{kind}">{html.escape(file.note)}</span>' if file.note else ""
        lines.append(
            f'<tr><td>{html.escape(file.what)}</td><td data-label="path">{breaking(file.path)}{note}</td>'
            f'<td data-label="SHA-256" class="digest">{file.sha256 or UNKNOWN}</td></tr>'
        )
    head = "<thead><tr><th>input</th><th>path</th><th>SHA-256</th></tr></thead>"
    return "\n".join(['<table class="stack inputs">', head, "<tbody>", *lines, "</tbody>", "</table>"])


# ---- A run directory as an input of a page ----

CHANGED = "not the file that the run wrote: run.json has another checksum"


def run_inputs(run: StoredRun) -> tuple[Input, ...]:
    """Scene, detector, manifest and tables of a run, with the checksums that the files have now.
    An interrupted run has its settings and the truth that it has kept in place of the last two.
    Of a labelled video, its labels and detections are the files. Raises InputError if a file cannot be read."""
    if run.made_of:
        return tuple(
            _file_or_folder(what, path) for what, path in zip(("labels", "detections"), run.made_of, strict=False)
        )
    work = run.folder if run.finished else run.folder / UNFINISHED
    scene_folder, copy = work / SCENE_FOLDER, run.scene.copy
    listing = RUN_FILE if run.finished else SETTINGS_FILE
    scene = Input(
        "scene of the run",
        str(scene_folder / copy.names[0]),
        run.settings["scene_sha256"],
        f"of the scene and every file that it names; {listing} has it as scene_sha256",
    )
    detector = scene_folder / str(copy.document["detector"])
    inputs = [scene, _run_file(run, detector, "detector file of the run")]
    if not run.finished:
        kept = folder_input("truth that the run has kept", work, work.glob(KEPT_TRUTH))
        return (*inputs, file_input("settings of the run", work / SETTINGS_FILE), kept)
    tables = {"truth.parquet": "truth", "frames.parquet": "frames and states", "detections.parquet": "detections"}
    written = [_run_file(run, run.folder / name, f"{what} of the run") for name, what in tables.items()]
    return (*inputs, file_input("manifest of the run", run.folder / RUN_FILE), *written)


def _run_file(run: StoredRun, path: Path, what: str) -> Input:
    """A file that the run has listed with its checksum; a file that was changed since stands out."""
    digest = sha256_of(path)
    listed = (run.settings.get("files") or {}).get(path.relative_to(run.folder).as_posix(), {}).get("sha256", digest)
    return Input(what, str(path), digest, "" if listed == digest else CHANGED, listed != digest)


def track_inputs(name: str, path: Path | None) -> Iterator[Input]:
    """The files with the tracks of a tracker."""
    what = f"tracks of {name}"
    yield Input(what, "given in memory", None) if path is None else _file_or_folder(what, path)


def _file_or_folder(what: str, path: Path) -> Input:
    """A file, or all files of a folder that are not hidden."""
    if not path.is_dir():
        return file_input(what, path)
    return folder_input(what, path, [file for file in path.rglob("*") if file.is_file() and file.name[0] != "."])


def run_seeds(run: StoredRun) -> tuple[tuple[str, str], ...]:
    """The seeds of a run."""
    seeds = {"scene": run.scene.seed, "detector": run.scene.detector_seed, "traffic": run.settings.get("traffic_seed")}
    return tuple((name, str(seed)) for name, seed in seeds.items() if seed is not None)


def run_versions(run: StoredRun) -> tuple[tuple[str, str], ...]:
    """The versions that made a run, and its renderer."""
    settings = run.settings
    rows = [("The run was made with", versions_in_words(settings["versions"]))]
    if truth := settings.get("truth_versions"):
        rows.append(("Its truth was made with", versions_in_words(truth)))
    rows.append(("The run's renderer", settings["backend"]))
    if settings.get("plugins"):
        rows.append(("Plug-ins", ", ".join(f"{name} of {package}" for name, package in settings["plugins"].items())))
    return tuple(rows)
