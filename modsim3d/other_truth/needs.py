"""What a detector file asks for that a labelled video may not have: distance and horizon."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import InputError


def check_needs(model: DetectorModel, source: str, depth_m: Array, horizon: Array | None) -> list[str]:
    """Remarks on what is left out.

    Args:
        model: The detector.
        source: What messages call its file.
        depth_m: Distance of each target, NaN where unknown, shape (n,).
        horizon: The half-plane of the sea, shape (3,); None if it is not known.

    Raises:
        InputError: The detector asks for what is not known.
    """
    problems = [*_distance_problems(model, depth_m), *([] if horizon is not None else _horizon_problems(model))]
    if problems:
        raise InputError(source, problems)
    return [] if horizon is not None else _left_out(model)


def _distance_problems(model: DetectorModel, depth_m: Array) -> Iterator[str]:
    unknown = int(np.isnan(depth_m).sum())
    if not unknown:
        return
    needed = (
        f"needs the distance of every vessel, which {unknown} of {len(depth_m)} boxes do not have: give distance_m of "
        "each annotation of a COCO file (MOT has no such column), or leave it out with "
    )
    if model.gates.max_range_m is not None:
        yield f"gates.max_range_m: {needed}--set detector.gates.max_range_m=null"
    keys = [] if not any(effect.attribute == "distance_m" for effect in model.dropout.effects) else ["dropout"]
    keys += [
        f"states.{model.states[state].name}.dropout"
        for state, effects in model.dropout.own.items()
        if any(effect.attribute == "distance_m" for effect in effects)
    ]
    if keys:
        without = " ".join(f"--set detector.{key}.distance_m=null" for key in keys)
        if {effect.attribute for effect in model.dropout.every_effect} == {"distance_m"}:
            without += " --set detector.dropout.model=confusion"
        yield f"{keys[0]}.distance_m: {needed}{without}"


def _horizon_problems(model: DetectorModel) -> Iterator[str]:
    placement = model.clutter.placement
    needed = "needs the horizon: give --horizon ROW, or X1,Y1,X2,Y2 where it is tilted, or leave it out with "
    if placement.band_px is not None:
        without = "--set detector.false_positives.placement=uniform --set detector.false_positives.band_px=null"
        yield f"false_positives.placement: horizon_band {needed}{without}"
    if placement.far_half_px is not None:
        yield f"false_positives.far_half_px: {needed}--set detector.false_positives.far_half_px=null"


def _left_out(model: DetectorModel) -> list[str]:
    """What a horizon would have changed."""
    if model.clutter.placement.density is not None:
        return []
    where = "false positives lie anywhere in the image, also in the sky: --horizon would keep them on the sea"
    return [where] if _has_clutter(model) else []


def _has_clutter(model: DetectorModel) -> bool:
    return any(getattr(state, model.clutter.numbers.rate_key) > 0 for state in model.states)
