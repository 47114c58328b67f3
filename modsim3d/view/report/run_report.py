"""The page of a run, or of two runs side by side, with all files that belong to it."""

from collections.abc import Callable, Mapping

from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path, out_file
from modsim3d.core.written_files import OutputFiles
from modsim3d.io.overwrite_guard import claimed, claimed_folders
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.selection import check_every
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.view.films.request import parse_look
from modsim3d.view.followed_tracks import followed_tracks, read_of_tracks
from modsim3d.view.report.images import FILM_FILES, film_frames
from modsim3d.view.report.report import PART_FILES, REPORT_FILE, parts_folder, write_report
from modsim3d.view.report.side_by_side import SIDE_BY_SIDE_FILE, write_side_by_side


def report(
    run: StoredRun | StrPath,
    out: StrPath | None = None,
    *,
    other: StoredRun | StrPath | None = None,
    every: int = 1,
    tracks: StrPath | None = None,
    similarity: str | None = None,
    threshold: float | None = None,
    pictures: StrPath | None = None,
    look: str | None = None,
    parts: bool = False,
    overwrite: bool = False,
    progress: Callable[[int], None] = lambda steps: None,
    call: str | None = None,
) -> OutputFiles:
    """Write a page that plays a run: images, boxes, timeline and tables in one file of HTML.

        page = modsim3d.report("runs/first", "page.html", tracks="tracks/reference")

    Args:
        run, out: A run or its directory; HTML file to write, `report.html` in the run directory if None.
        other: Another run of the same truth, to show beside the first.
        every: Take every K-th time step; the tables count all.
        tracks: Tracks of a tracker to show: a folder of `track_run`, or a file.
        similarity: Similarity of a track's box and a vessel's: `iou`, or by distance, `centre:40`, 0 from 40 px on.
        threshold: Least similarity at which a track follows a vessel; 0.5 if None.
        pictures: Pictures to show below the boxes: a folder with one for each frame, or a film.
        look: How vessels and sea look in pictures of mistakes below the boxes, such as `shaded`; none if None.
        parts: Write the frames into a folder beside the page, for very long runs.
        overwrite: Replace what is there.
        progress: Called with the number of steps done since its last call.
        call: Command that made the page, for its foot; this function if None.

    Raises:
        ModsimError: The runs, the tracks or the pictures are wrong, or the page cannot be written.
        TypeError: A path is neither text nor a path.
    """
    _check_together(other, {"--tracks": tracks, "--pictures": pictures, "--look": look})
    drawn_as = None if look is None else parse_look(look)
    check_every(every)
    run, second = opened_run(run), None if other is None else opened_run(other)
    read = [*read_of_run(run.folder), *read_of_tracks(tracks), *([] if second is None else read_of_run(second.folder))]
    followed = followed_tracks(tracks, run, similarity, threshold)
    path = out_file(out, run.folder / (REPORT_FILE if second is None else SIDE_BY_SIDE_FILE))
    images = None if pictures is None else as_path(pictures, "pictures")
    film = path.with_name(f"{path.stem}_images") if images is not None and images.is_file() else None
    folders = ({parts_folder(path): PART_FILES} if parts else {}) | ({film: FILM_FILES} if film else {})
    with claimed([path], overwrite=overwrite, inputs=read), claimed_folders(folders, overwrite=overwrite, inputs=read):
        if images is not None and film is not None:
            images = film_frames(images, film, run)
        if second is not None:
            write_side_by_side(run, second, path, every, progress, call, in_files=parts)
        else:
            shown = None if tracks is None else as_path(tracks, "tracks")
            of = (run, path, every, progress, followed, call, shown)
            write_report(*of, in_files=parts, pictures=images, look=drawn_as)
    return OutputFiles((path, *folders), () if followed is None else (followed.sentence(),))


def _check_together(other: StoredRun | StrPath | None, given: Mapping[str, object]) -> None:
    """Raise ModsimError if there is another run beside what is for one, or both pictures and a look."""
    for name, value in given.items():
        if other is not None and value is not None:
            raise ModsimError(f"{name} is for one run: leave out RUN_B, or {name}")
    if given["--look"] is not None and given["--pictures"] is not None:
        raise ModsimError("--look and --pictures each say what is below the boxes: leave one out")
