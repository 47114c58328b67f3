"""Runs to report on, and a browser to look at the pages with."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from modsim3d import RunRows, detect_run, load_scene, open_run, run_scene
from modsim3d.tracks.tracks import Similarity
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.report.report import write_report
from tests.view.conftest import as_set, perfect, swapped, with_false
from tests.view.report.browser import Browser, open_browser

STEPS = 260
SWAP, FALSE = 100, range(40, 60)  # steps at which made tracks change their vessels, and in which one follows nothing


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras, waves, occlusion, several performance states; without OpenGL, as no test here is about pixels."""
    folder = tmp_path_factory.mktemp("report") / "run"
    run_scene(load_scene("simulation_3", mode=2, seed=5, steps=STEPS, source="analytic"), folder)
    return folder


@pytest.fixture(scope="session")
def page(run_folder: Path) -> Path:
    return write_report(open_run(run_folder))


@pytest.fixture(scope="session")
def other_folder(mistaken_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The detector of the mistaken run over the same truth, with another seed."""
    folder = tmp_path_factory.mktemp("other") / "other"
    detect_run(mistaken_folder, folder, seed=77)
    return folder


@pytest.fixture(scope="session")
def mistaken_page(mistaken_folder: Path) -> Path:
    return write_report(open_run(mistaken_folder))


@pytest.fixture(scope="session")
def rows(run_folder: Path) -> RunRows:
    return RunRows.of(open_run(run_folder))


@pytest.fixture(scope="session")
def pair(rows: RunRows) -> tuple[int, int]:
    """Two vessels that the first camera sees before and after the swap."""
    tracks = perfect(rows)
    here = tracks.take(tracks.camera == 0)
    seen = [set(here.track[here.step == step].tolist()) for step in (SWAP - 5, SWAP - 1, SWAP, SWAP + 5)]
    return tuple(sorted(set.intersection(*seen))[:2])


@pytest.fixture(scope="session")
def followed(rows: RunRows, pair: tuple[int, int]) -> FollowedTracks:
    return FollowedTracks.of(as_set(with_false(swapped(perfect(rows), *pair, SWAP), FALSE)), rows, Similarity())


@pytest.fixture(scope="session")
def tracks_page(run_folder: Path, followed: FollowedTracks, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tracks") / "tracks.html"
    return write_report(open_run(run_folder), out, followed=followed)


@pytest.fixture(scope="session")
def shared_browser() -> Iterator[Browser]:
    with open_browser() as browser:
        yield browser


@pytest.fixture
def browser(shared_browser: Browser) -> Iterator[Browser]:
    """The session's browser; whatever a test did with it, it must have had nothing to complain of."""
    shared_browser.errors.clear()  # those of a test that failed
    shared_browser.scheme("light")
    yield shared_browser
    assert shared_browser.errors == []
