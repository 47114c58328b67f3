"""Means that are known beforehand: given, taken off, and told."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import orjson
import pytest

from benchmarks.voyages.wrong_camera import Voyage
from modsim3d.core.errors import InputError
from modsim3d.learn.voyage.camera_registration import KnownMeans, Registering, check_known, parse_known
from modsim3d.learn.voyage.labelled_voyage import LabelledVoyage, VoyageOptions, labelled_voyage, scene_files
from modsim3d.learn.voyage.log_to_scene import on_scene
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.learn.voyage.registration.identifiability import ConfoundedGroup
from modsim3d.learn.voyage.report import delay_of, exchanges, registration_table
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.scene_folder import write_scene
from modsim3d.scene.ais.traffic import read_traffic
from modsim3d.scene.reading import load_scene
from tests.learn.voyage.strait_logs import written

SAMPLE = Path("tests/data/ais/receiver.nmea")
KNOWN = KnownMeans(mean_x_px=6.0, delay_s=2.0)


@pytest.fixture(scope="module")
def voyage(tmp_path_factory: pytest.TempPathFactory) -> LabelledVoyage:
    """A camera whose boxes are 6 px too far to the right, and vessels whose reports are two seconds late."""
    folder = tmp_path_factory.mktemp("known")
    write_scene(read_traffic([SAMPLE], Options()), folder / "ais", Path("benchmarks/voyages/one_label.yaml"))
    scene = load_scene(folder / "ais", source="analytic", steps=200)
    found = Voyage.of(KNOWN.scene_of(scene), "shore", {}).detections(0)
    log = written(folder / "log.csv", found.times_s[found.frame], found.boxes_px + np.array([6.0, 0, 6.0, 0]))
    return labelled_voyage(on_scene(read_log(log), scene), VoyageOptions(Registering(("k1",), known=KNOWN)))


def test_known_means_are_taken_off_and_the_truth_has_the_vessels_where_they_were(voyage: LabelledVoyage) -> None:
    """Six pixels look like 0.24° of yaw, and two seconds of delay like as much of the clock."""
    registration = voyage.registered[0].registration
    assert registration["yaw_deg"].value == pytest.approx(0, abs=0.04)
    assert registration["clock_s"].value == pytest.approx(0, abs=0.5)
    assert registration["mean_x_px"].value == 6
    moved = voyage.scene.poses.poses(100, 101).positions_m
    reported = load_scene(voyage.scene.path).poses.poses(102, 103).positions_m
    np.testing.assert_allclose(moved, reported, atol=1e-6)
    assert "reports of vessels are taken to be 2 s late, as was given" in voyage.labelled.notes


def test_known_means_are_told_in_the_table_and_beside_the_written_scene(voyage: LabelledVoyage) -> None:
    (registered,) = voyage.registered
    rows = {row[0]: row[-1] for row in registration_table(registered, voyage.scene).rows}
    assert rows["mean box error in x"] == "given as +6 px"
    assert rows["mean box error in y"] == "mean errors are taken to be zero"
    assert rows["mean delay of all reports"] == "given as +2 s"
    assert delay_of(registered).value == 2
    files = scene_files(load_scene(voyage.scene.path), voyage.registered, Path("there"))
    noted = orjson.loads(files[Path("there/registration.json")])["cameras"]["shore"]
    assert noted["known"] == {"mean_x_px": 6, "delay_s": 2}


def test_what_looks_alike_is_told_by_the_step_that_is_named(voyage: LabelledVoyage) -> None:
    """Shares and coefficients are told for a step of 0.01, all others for one of their units."""
    groups = (
        ConfoundedGroup("k1", (("focal_share", -0.08), ("yaw_deg", 2.0))),
        ConfoundedGroup("mean_x_px", (("yaw_deg", -0.04),)),
    )
    assert list(exchanges(replace(voyage.registered[0].registration, groups=groups))) == [
        "lens distortion k1 is held; +0.01 of it would look like -0.08 % of focal length, +0.02° of yaw of the camera",
        "mean box error in x is held; +1 px of it would look like -0.04° of yaw of the camera",
    ]


def test_names_and_values_are_read_and_what_is_no_mean_is_refused() -> None:
    assert parse_known("mean_x=1.5, mean_height=-0.02,delay=2") == KnownMeans(1.5, None, None, -0.02, 2)
    assert parse_known({"delay": 3}) == KnownMeans(delay_s=3)
    assert parse_known(None) == KnownMeans()
    for text, said in (
        ("", "must be NAME=VALUE,..., such as mean_x=1.5,delay=2, with the names mean_x, mean_y, mean_width"),
        ("mean_x", "(got 'mean_x')"),
        ("mean_z=1", "no mean 'mean_z' (did you mean 'mean_y'?)"),
        ("yaw=1", "no mean 'yaw' (known: mean_x, mean_y, mean_width, mean_height, delay)"),
        ("delay=1,delay=2", "delay: is given twice"),
        ("delay=soon", "delay: must be a number (got 'soon')"),
        ("mean_width=-1", "mean_width: must be a share above -1 and below 1, such as 0.02 (got '-1')"),
        ("mean_x=inf", "mean_x: must be a number (got 'inf')"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            parse_known(text)
    with pytest.raises(InputError, match="--fixed all leaves out"):
        check_known(KnownMeans(mean_x_px=1), ("all",))
    check_known(KnownMeans(delay_s=1), ("all",))
