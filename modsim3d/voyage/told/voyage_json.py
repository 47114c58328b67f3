"""What `modsim3d learn --json` says of a voyage."""

from __future__ import annotations

from typing import Any

from modsim3d.learn.numbers.resampling import Column
from modsim3d.voyage.labelled_voyage import Registered
from modsim3d.voyage.told.registration_table import delay_of, exchanges
from modsim3d.voyage.told.voyage_report import VoyageReport
from modsim3d.voyage.truth_noise.taken_off import ComponentNoise
from modsim3d.voyage.unseen.rates import StateRates


def voyage_json(told: VoyageReport) -> dict[str, Any]:
    """Registrations, rates of false positives as bounds, box errors less errors of truth, and coverage."""
    return {
        "registration": [_registration(each) for each in told.voyage.registered],
        "false_positives_per_image": [_rates(each, told.level) for each in told.rates],
        "box_errors": [_box_error(each) for each in told.taken_off.components()],
        "coverage": [
            {
                "camera": each.camera,
                "bearings_deg": each.bearings_deg.tolist(),
                "ranges_m": each.ranges_m.tolist(),
                "matched": each.counts()[0].astype(int).tolist(),
                "to_be_detected": each.counts()[1].astype(int).tolist(),
            }
            for each in told.coverage
        ],
    }


def _registration(registered: Registered) -> dict[str, Any]:
    found = registered.registration
    return {
        "camera": found.camera,
        "log": registered.source,
        "matches": len(found.sightings),
        "detections": found.detections,
        "vessels": found.matched_vessels,
        "residual_before_px": found.rms_before_px,
        "residual_after_px": found.rms_after_px,
        "clock_before_s": registered.clock_s,
        "parameters": [
            {"name": each.name, "unit": each.unit, "value": each.value, "low": each.low, "high": each.high}
            | {"held": each.held or None}
            for each in (*found.estimates, delay_of(registered), *found.vessels)
        ],
        "held_by_rule": list(exchanges(found)),
    }


def _box_error(error: ComponentNoise) -> dict[str, Any]:
    names = ("learned", "from_errors_of_truth", "at_least", "written")
    about = {"state": error.state, "component": error.component, "unit": error.unit}
    return about | dict(zip(names, error.std, strict=True)) | {"upper_bound": error.upper_bound}


def _rates(rates: StateRates, level: float) -> dict[str, Any]:
    def found(column: Column | None) -> dict[str, float] | None:
        if column is None:
            return None
        low, high = column.interval(level, rates.units)
        return {"value": float(column.estimate), "low": float(low), "high": float(high)}

    return {
        "state": rates.state,
        "unmatched": rates.unmatched,
        "like_vessels": found(rates.vessel_share if rates.mixture else None),
        "least": found(rates.lower),
        "by_lifetimes": found(rates.mixture),
        "most": found(rates.upper),
        "in_empty_stretches": found(rates.empty),
        "used": rates.source.value,
    }
