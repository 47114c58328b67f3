"""Films of scenes in light and shade, each with its truth and with what a detector makes of its pixels.

A film is a folder with `film.json`, the run that its truth is from, `truth.json` (COCO) and `real.json` (COCO results).
A film that is there is not made again. Run it with `python -m benchmarks.stand_in.films --work FOLDER`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from PIL import Image

from benchmarks.processes import ROOT, say
from benchmarks.stand_in.pixel_detector import Found, PixelDetector, open_session
from benchmarks.stand_in.places import PLACES, WEATHERS, place_scene, style_of
from benchmarks.stand_in.weights import fetched_weights
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled import Results
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco import coco_results, ground_truth
from modsim3d.io.atomic_write import write_files
from modsim3d.runs.run import run_scene
from modsim3d.scene.scene import Scene
from modsim3d.view.films.renderer import open_shaded_picture_renderer
from modsim3d.view.pictures.canvas import Window
from modsim3d.view.pictures.plain import Solids

WORK = ROOT / "runs" / "stand_in"
RATE_HZ = 4.0
TO_LEARN_FROM, TO_COMPARE_ON, TO_JUDGE_ON = 7, 16, 50
"""Films of each place."""
ROLES = ("compare", "learn")
"""They take turns."""
FIRST_SEED, FIRST_JUDGED_SEED = 101, 1001
"""Of the first film; each film has a seed of its own."""
ON_BOARD = (1, 3, 5, 9, 11, 13)
"""Of each 16 films of a place and a role, those whose camera is on board: two in each weather."""


@dataclass(frozen=True)
class Film:
    """A film of traffic that no other film has.

    Attributes:
        folder: Where it is.
        name: Of the folder.
        place: One of `PLACES`.
        weather: One of `WEATHERS`.
        viewpoint: Camera: `shore`, or `own` on board.
        seed: What its traffic is drawn from.
        role: `learn`, `compare`, or `judge`.
        rate_hz: Images in a second.
    """

    folder: Path
    name: str
    place: str
    weather: str
    viewpoint: str
    seed: int
    role: str
    rate_hz: float = RATE_HZ

    @property
    def run(self) -> Path:
        """The run directory."""
        return self.folder / "run"

    @property
    def truth(self) -> Path:
        """What is annotated, as COCO."""
        return self.folder / "truth.json"

    @property
    def real(self) -> Path:
        """What the detector found in the pixels, as COCO results."""
        return self.folder / "real.json"

    @property
    def description(self) -> Path:
        """The file that says which film it is; it is written last."""
        return self.folder / "film.json"

    @property
    def content(self) -> dict[str, Any]:
        """What stands in the description."""
        return {name: value for name, value in asdict(self).items() if name != "folder"}

    def scene(self, steps: int | None = None) -> Scene:
        """What is filmed."""
        return place_scene(self.place, self.viewpoint, self.weather, self.seed, steps)


def all_films(work: Path) -> list[Film]:
    """The films to work with, in the order in which they are made: places, weathers and roles take turns.

    The two roles share no seed, so what is compared on is traffic that no learning saw.
    """
    turns = [(role, k) for k in range(TO_COMPARE_ON) for role in ROLES if role == "compare" or k < TO_LEARN_FROM]
    return _films(work, turns, FIRST_SEED)


def judged_films(work: Path) -> list[Film]:
    """The films that the models are judged on, once, when all of them are there and no model changes any more.

    None of their traffic is in `all_films`.
    """
    return _films(work, [("judge", k) for k in range(TO_JUDGE_ON)], FIRST_JUDGED_SEED)


def _films(work: Path, turns: Sequence[tuple[str, int]], first_seed: int) -> list[Film]:
    """A film of each place for each role and number."""
    films: list[Film] = []
    for role, k in turns:
        for p, place in enumerate(PLACES):
            seed = first_seed + len(films)
            weather = WEATHERS[(k + p) % len(WEATHERS)]
            name = f"{place}_{weather.replace(' ', '')}_{seed}"
            viewpoint = "own" if k % 16 in ON_BOARD else "shore"
            films.append(Film(work / "films" / name, name, place, weather, viewpoint, seed, role))
    return films


def stored_films(work: Path) -> list[Film]:
    """The films of a work folder that are complete, by name.

    Raises:
        ModsimError: The description of one cannot be read.
    """
    return [_stored(path) for path in sorted((work / "films").glob("*/film.json"))]


def _stored(path: Path) -> Film:
    try:
        return Film(path.parent, **json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ModsimError(f"{path}: it describes no film ({error}): delete its folder and make it again") from None


def pictures(scene: Scene, weather: str) -> Iterator[tuple[Image.Image, float]]:
    """Each picture of a scene's first camera in a weather, and the row of the horizon in its middle column."""
    camera = scene.cameras[0]
    width, height = camera.intrinsics.image_size_px
    window = Window(0.0, 0.0, 1.0, (width, height))
    with open_shaded_picture_renderer(style_of(weather)) as renderer:
        for step in range(scene.steps):
            solids = Solids.at(scene, camera, step)
            a, b, c = solids.sea_half_plane
            yield renderer.picture(solids, window), -(a * width / 2 + c) / b


def make_film(film: Film, detector: PixelDetector, steps: int | None = None) -> None:
    """Run the scene, show its pictures to the detector, and write what is in a film's folder."""
    scene = film.scene(steps)
    run_scene(scene, film.run, overwrite=True)
    labelled, _ = labelled_run(film.run)
    found = [detector.detect(picture, horizon_px) for picture, horizon_px in pictures(scene, film.weather)]
    real = coco_results(replace(labelled, results=_results(found)))
    content = {film.truth: orjson.dumps(ground_truth(labelled)), film.real: orjson.dumps(real)}
    write_files(content)
    write_files({film.description: json.dumps(film.content, indent=1) + "\n"})


def _results(found: Sequence[Found]) -> Results:
    """The boxes of all images, in their order."""
    counts = [len(each.confidence) for each in found]
    return Results(
        image=np.repeat(np.arange(len(found)), counts),
        label=np.zeros(sum(counts), dtype=np.int64),
        boxes_px=np.concatenate([each.boxes_px for each in found]),
        confidence=np.concatenate([each.confidence for each in found]),
    )


def make_films(work: Path, films: Sequence[Film], workers: int = 2) -> None:
    """Make the films that are not there yet.

    Raises:
        ModsimError: The weights are not to be had, or a film that is there is another one of the same name.
    """
    there = {film.name: film for film in stored_films(work)}
    for film in films:
        if there.get(film.name, film) != film:
            raise ModsimError(f"{film.folder}: another film has this name: delete its folder and run again")
    missing = [film for film in films if film.name not in there]
    if not missing:
        return
    weights = fetched_weights(work)
    open_session(weights)  # an error comes before the work
    started = time.monotonic()
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for k, name in enumerate(pool.map(_made, missing, [weights] * len(missing)), 1):
            say(f"{time.monotonic() - started:6.0f} s  {k} of {len(missing)} films: {name}")


def _made(film: Film, weights: Path) -> str:
    """In a process of its own; another one that works on the same films may have made it by now."""
    if not film.description.is_file():
        make_film(film, PixelDetector(open_session(weights)))
    return film.name


def _count(text: str) -> int:
    """A number of films or processes on the command line."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"needs a whole number from 1 on (got {text!r})")
    return int(text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=WORK, metavar="DIR", help="where the films and the weights are")
    parser.add_argument("--judged", action="store_true", help="the films that the models are judged on")
    parser.add_argument("--films", type=_count, metavar="N", help="only the first N")
    parser.add_argument("--workers", type=_count, default=2, metavar="N", help="processes (2 unless given)")
    given = parser.parse_args()
    try:
        films = judged_films(given.work) if given.judged else all_films(given.work)
        make_films(given.work, films[: given.films], given.workers)
    except ModsimError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
