"""Labelled sets whose truth is wrong by known amounts, as if it came from AIS."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.learned import Settings, learn
from modsim3d.learn.observed.observed import Observed
from modsim3d.learn.states.transitions import Transitions
from modsim3d.scene.reading import data_folder, load_scene
from modsim3d.voyage.truth_noise.jacobians import View
from tests.formats.labelled_sets import found, images, truth


@cache
def strait():
    return load_scene(str(data_folder("scenes") / "strait.yaml"))


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


def noisy_set(scene, view, times, seed, position_m, lasting_s, covariance):
    """Detections are true boxes with errors of a covariance (4, 4) in pixels; annotations come from wrong places."""
    rng = np.random.default_rng(seed)
    true = boxes_of(scene, view, view.poses)
    reported = boxes_of(scene, view, moved(view.poses, slow_noise(rng, times, true.shape[1], position_m, lasting_s)))
    frame, vessel = np.nonzero(np.isfinite(true).all(axis=-1) & np.isfinite(reported).all(axis=-1))
    errors = rng.multivariate_normal(np.zeros(4), covariance, len(frame))
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
    state = np.zeros(len(labelled.images), dtype=np.int64)
    matched = match(labelled, Rule("provenance"), 0.2)
    observed = Observed(labelled, matched, ("all",), state, 0.2, frozenset(without))
    return learn(observed, Transitions(np.zeros((1, 1))), Settings(replicates=replicates))
