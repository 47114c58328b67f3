"""Labelled sets whose truth is wrong by known amounts, as if it came from AIS."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule
from modsim3d.learn.voyage.reference_error import View
from modsim3d.scene.scene import Scene
from tests.formats.labelled_sets import found, images, truth
from tests.learn.one_state import detector_file, learned_in, observed_in

VESSELS, STEPS, STEP_S = 12, 300, 4.0
DETECTOR = detector_file(
    "all",
    false=0.1,
    box_error={"unit": "px", "mean": [0.0] * 4, "covariance": np.eye(4).tolist()},
    confidence={"true": {"mean": 0.7, "std": 0.1}, "false": {"mean": 0.5, "std": 0.1}},
) | {"false_positives": {"model": "calibrated"}}


@cache
def roads():
    """Twelve vessels 0.5 to 2 km before a camera ashore, for 20 minutes."""
    rng = np.random.default_rng(1)
    vessels = {
        f"v{k}": {"length_m": length, "beam_m": length / 6, "air_draft_m": length / 5, "label": "boat"}
        for k, length in enumerate(np.linspace(30, 150, VESSELS).tolist())
    }
    times = np.arange(STEPS) * STEP_S
    start = np.column_stack([rng.uniform(600, 1900, VESSELS), rng.uniform(-250, 250, VESSELS)])
    course = rng.uniform(0, 2 * np.pi, VESSELS)
    way = np.stack([np.cos(course), np.sin(course)], axis=-1) * 0.15
    positions = start + times[:, None, None] * way
    poses = {"positions_m": positions, "headings_rad": np.tile(course, (STEPS, 1)), "time_step_s": STEP_S}
    camera = {
        "focal_length_m": 0.008,
        "pixel_size_m": [5e-6, 5e-6],
        "principal_point_px": [960, 540],
        "image_size_px": [1920, 1080],
        "pose": {"position_m": [0, 0, 25], "yaw_rad": 0.0},
    }
    return Scene.from_dict({"vessels": vessels, "poses": poses, "cameras": {"shore": camera}, "detector": DETECTOR})


def view_of(scene, steps):
    return View(scene.cameras[0], scene.motion.at(steps), np.arange(len(steps)))


def boxes_of(scene, view, poses):
    """Boxes of all vessels in each frame by the project's own outlines, NaN where none is whole, shape (S, V, 4)."""
    steps = np.arange(len(view.images))
    outlines = scene.sight(view.camera, steps, poses).outlines(as_shoeboxes=True)
    boxes = np.full((len(steps), len(scene.vessels), 4), np.nan)
    whole = outlines.boxed & (outlines.in_frame_fraction == 1.0)
    boxes[outlines.frame[whole], outlines.occluder[whole]] = outlines.boxes_px[whole]
    return boxes


def moved(poses, offsets_m):
    """Poses with places moved east and north, shape (S, V, 2)."""
    places = poses.poses.positions_m.copy()
    places[..., :2] += offsets_m
    return replace(poses, poses=replace(poses.poses, positions_m=places))


def slow_noise(rng, times, vessels, std, lasting_s):
    """Ornstein-Uhlenbeck errors east and north, shape (S, V, 2)."""
    noise = rng.normal(0, std, (len(times), vessels, 2))
    for k in range(1, len(times)):
        kept = np.exp(-(times[k] - times[k - 1]) / lasting_s)
        noise[k] = kept * noise[k - 1] + np.sqrt(1 - kept**2) * noise[k]
    return noise


def noisy_set(scene, view, times, seed, position_m, lasting_s, covariance, kept=0.0, box_s=0.0):
    """Detections are true boxes with errors of a covariance (4, 4) in pixels; annotations come from wrong places.

    Vessels keep a share of the errors, and the rest lasts for `box_s`.
    """
    rng = np.random.default_rng(seed)
    true = boxes_of(scene, view, view.poses)
    reported = boxes_of(scene, view, moved(view.poses, slow_noise(rng, times, true.shape[1], position_m, lasting_s)))
    frame, vessel = np.nonzero(np.isfinite(true).all(axis=-1) & np.isfinite(reported).all(axis=-1))
    white = rng.normal(size=(len(frame), 4))
    if box_s:
        lasting = np.concatenate([slow_noise(rng, times, true.shape[1], 1.0, box_s) for _ in range(2)], axis=-1)
        own = rng.normal(size=(true.shape[1], 4))
        white = np.sqrt(1 - kept) * lasting[frame, vessel] + np.sqrt(kept) * own[vessel]
    errors = white @ np.linalg.cholesky(covariance).T
    box = true[frame, vessel]
    shift, half = errors[:, :2], errors[:, 2:] / 2
    seen = box + np.concatenate([shift - half, shift + half], axis=1)
    width_height = tuple(float(side) for side in view.camera.intrinsics.image_size_px)
    return LabelledSet(
        ("boat",),
        ("all",),
        images(len(times), width_height, times),
        truth(frame, 0 * frame, reported[frame, vessel], identity=vessel),
        found(frame, 0 * frame, seen, np.full(len(frame), 0.9), origin=np.arange(len(frame))),
    )


def learned_from(labelled, replicates=60, without=("places", "sizes", "merges", "splits", "duplicates")):
    return learned_in(observed_in(labelled, Rule("provenance"), without, "all"), replicates=replicates)
