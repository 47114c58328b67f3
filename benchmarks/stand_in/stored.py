"""What the pretrained detector found in all films, in one file.

With it the comparison can be made again without the detector's weights and without drawing the films.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from benchmarks.processes import ROOT
from benchmarks.stand_in.films import Film, stored_films
from benchmarks.stand_in.rungs import MIN_CONFIDENCE
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco import ground_truth
from modsim3d.io.atomic_write import write_files
from modsim3d.runs.run import run_scene

STORED = ROOT / "docs" / "campaigns" / "stand_in_detections.parquet"
JUDGED = STORED.with_name("stand_in_judged.parquet")
"""The films to work with, from `MIN_CONFIDENCE` on; those that models are judged on, with all that was found."""
_BOX_DIGITS, _SCORE_DIGITS = 3, 6
"""Decimals of the files of films."""
_NUMBERS = ("image", "x", "y", "width", "height", "score")


def store(films: Sequence[Film], path: Path = STORED, least: float = MIN_CONFIDENCE) -> None:
    """Write what was found in films from a confidence on.

    Columns are whole thousandths of a pixel and millionths of confidence.
    """
    parts = []
    for film in films:
        every = json.loads(film.real.read_text(encoding="utf-8"))
        found = [each for each in every if each["score"] >= least]
        box = np.array([each["bbox"] for each in found], dtype=np.float64).reshape(-1, 4)
        columns = {name: _whole(box[:, k], _BOX_DIGITS) for k, name in enumerate(("x", "y", "width", "height"))}
        score = _whole(np.array([each["score"] for each in found], dtype=np.float64), _SCORE_DIGITS)
        image = np.array([each["image_id"] for each in found], dtype=np.int16)
        name = pa.array([film.name] * len(found)).dictionary_encode()
        parts.append(pa.table({"film": name, "image": image, **columns, "score": score}))
    pq.write_table(
        pa.concat_tables(parts).unify_dictionaries(),
        path,
        compression="zstd",
        compression_level=19,
        use_dictionary=["film"],
        column_encoding=dict.fromkeys(_NUMBERS, "DELTA_BINARY_PACKED"),
    )


def restore_films(work: Path, films: Sequence[Film], path: Path = STORED) -> None:
    """Make the films that are not there yet from their scenes and from what was found in them, without pictures.

    Raises:
        ModsimError: The file cannot be read, or does not have one of the films.
    """
    there = {film.name for film in stored_films(work)}
    if there >= {film.name for film in films}:
        return
    try:
        found = pq.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise ModsimError(f"{path}: cannot be read as stored detections ({error})") from None
    for film in films:
        if film.name not in there:
            restore_film(film, found.filter(pc.equal(found["film"].cast(pa.string()), film.name)))


def names_in(path: Path) -> set[str]:
    """Names of the films of a file; none if it is not there."""
    return set(pq.read_table(path, columns=["film"])["film"].to_pylist()) if path.is_file() else set()


def restore_film(film: Film, found: pa.Table) -> None:
    """Run a film's scene and write its folder, with detections from its rows of the stored table.

    Raises:
        ModsimError: The table is empty.
    """
    if not len(found):
        raise ModsimError(f"{film.name}: nothing is stored of this film: draw it with --draw")
    run_scene(film.scene(), film.run, overwrite=True)
    box = np.column_stack([found[name].to_numpy() for name in ("x", "y", "width", "height")]) / 10**_BOX_DIGITS
    score = found["score"].to_numpy() / 10**_SCORE_DIGITS
    real = [
        {"image_id": image, "category_id": 1, "bbox": sides, "score": confidence}
        for image, sides, confidence in zip(found["image"].to_pylist(), box.tolist(), score.tolist(), strict=True)
    ]
    truth = ground_truth(labelled_run(film.run)[0])
    write_files({film.truth: orjson.dumps(truth), film.real: orjson.dumps(real)})
    write_files({film.description: json.dumps(film.content, indent=1) + "\n"})


def _whole(values: np.ndarray, digits: int) -> np.ndarray:
    whole: np.ndarray = np.round(values * 10**digits).astype(np.int32)
    return whole
