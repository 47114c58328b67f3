"""Keys of a detector file that nothing reads, because of the models and values that the file chooses."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modsim3d.detector.dropout import ATTRIBUTES
from modsim3d.detector.false_positives import FALSE_POSITIVE_MODELS
from modsim3d.detector.file.reading import file_of
from modsim3d.detector.file.schema import DetectorFile
from modsim3d.detector.model import DetectorModel

_CHAIN = ("initial_state", "transition_matrix", "transition_interval_s", "performance.scope")
_PLACES = ("placement", "band_px", "density", "far_half_px", "size", "persistence")


@dataclass(frozen=True)
class UnreadKey:
    """A key that nothing reads, with all below it."""

    path: str  # keys that lead to it, with dots between them
    reason: str  # why nothing reads it, and the key that would work
    switches: tuple[str, ...] = ()  # keys one of which makes it read
    is_dead: bool = False  # whether the file has it in vain, whatever states a run forces


def dead_lines(model: DetectorModel) -> list[str]:
    """A sentence for each key that the detector's file has in vain."""
    return [f"nothing reads {key.path} in the detector file: {key.reason}" for key in _keys_of(model) if key.is_dead]


def unread_settings(model: DetectorModel, paths: Collection[str], named: Collection[str] = ()) -> dict[str, str]:
    """Keys among `paths` that nothing reads in a detector with them, each with its reason. A key beside the one that
    switches it off or on, in `paths` or `named`, is left out."""
    reasons: dict[str, str] = {}
    for key in _keys_of(model):
        if any(_is_within(path, switch) for path in (*paths, *named) for switch in key.switches):
            continue
        for path in paths:
            if _is_within(path, key.path) or (key.is_dead and _is_within(key.path, path)):
                reasons.setdefault(path, key.reason if path == key.path else f"{key.path}: {key.reason}")
    return reasons


def _keys_of(model: DetectorModel) -> list[UnreadKey]:
    """All of them; none of a detector that was not read from a file."""
    file = file_of(model)
    if file is None:
        return []
    given = {*_paths(file.model_dump(exclude_defaults=True))}
    return [replace(key, is_dead=key.is_dead and key.path in given) for key in _unread_keys(file)]


def _paths(content: Mapping[str, Any], before: str = "") -> Iterator[str]:
    for name, value in content.items():
        yield f"{before}{name}"
        if isinstance(value, Mapping):
            yield from _paths(value, f"{before}{name}.")


def _is_within(path: str, other: str) -> bool:
    return path == other or path.startswith(f"{other}.")


def _unread_keys(file: DetectorFile) -> Iterator[UnreadKey]:
    schedule, one = file.performance.schedule, len(file.states) == 1
    forced = bool(schedule) and schedule[0][0] == 0 and all(state is not None for _, state in schedule)
    names, steps = [*file.states], np.eye(len(file.states)) + np.array(file.transition_matrix, dtype=np.float64)
    reached = np.linalg.matrix_power(steps, len(names))[:, names.index(file.initial_state)] > 0
    entered = {state for _, state in schedule}
    states = [name for name, chain in zip(names, reached, strict=True) if name in entered or (chain and not forced)]
    measured = "drops nothing, for it is the confidence from which on the detector was measured"
    yield UnreadKey("confidence_threshold", f"{measured}: set detector.operating_threshold")
    for name in _CHAIN if one or forced else ():
        why = "the detector has one state" if one else "a state is forced at every step"
        yield UnreadKey(name, f"{why}: set detector.performance.schedule", is_dead=one and name in _CHAIN[2:])
    for name in (name for name in names if name not in states):
        never = f"the detector is never in state {name}, but in {', '.join(states)}"
        yield UnreadKey(f"states.{name}", f"{never}: set keys of that, or detector.performance.schedule")
    yield from _unread_rates(file, states)
    yield from _unread_effects(file, states)
    yield from _switched_off(file)


def _unread_rates(file: DetectorFile, states: list[str]) -> Iterator[UnreadKey]:
    """Rates of false positives of which the model reads another, and what false positives have where there are none."""
    false_positives, rates = file.false_positives, dict[str, tuple[str, float | None]]()
    for name, state in file.states.items():
        path, own = f"states.{name}.false_discovery_rate", state.false_positives_per_image
        rates[name] = path, state.false_discovery_rate
        if FALSE_POSITIVE_MODELS[false_positives.model].rate_key == "false_positives_per_image":
            rates[name] = f"states.{name}.false_positives_per_image", own
            if own is None:
                rates[name] = "false_positives.rate", false_positives.rate
            yield UnreadKey(
                path, f"model {false_positives.model} does not read it: set detector.{rates[name][0]}", is_dead=True
            )
    used = tuple(rates[name][0] for name in states)
    if "false_positives.rate" not in used:
        works = " and ".join(f"detector.{path}" for path in used)
        dead = all(path != "false_positives.rate" for path, _ in rates.values())
        yield UnreadKey("false_positives.rate", f"each state has a rate of its own: set {works}", is_dead=dead)
    if not any(rates[name][1] for name in states):
        labels = [f"states.{name}.false_positive_labels" for name in states]
        for path in (*labels, *(f"false_positives.{name}" for name in _PLACES)):
            yield UnreadKey(path, f"there are no false positives: set detector.{used[0]}", used)


def _unread_effects(file: DetectorFile, states: list[str]) -> Iterator[UnreadKey]:
    """Effects on misses that each state replaces, and references that change nothing."""
    sections = {f"states.{name}.dropout": state.dropout.effects() for name, state in file.states.items()}
    for name in ATTRIBUTES:
        if all(name in sections[f"states.{state}.dropout"] for state in states):
            works = " and ".join(f"detector.states.{state}.dropout.{name}" for state in states)
            dead = all(name in effects for effects in sections.values())
            yield UnreadKey(f"dropout.{name}", f"each state has its own: set {works}", is_dead=dead)
    for path in ("dropout", *sections):
        yield UnreadKey(f"{path}.learned_log_odds", "only miss_rate reads it: set detector.miss_rate", ("miss_rate",))
    for path, effects in {"dropout": file.dropout.effects(), **sections}.items():
        for name, effect in effects.items():
            slope = f"{path}.{name}.{'per_doubling' if effect.per_unit is None else 'per_unit'}"
            if 0 in (effect.per_unit, effect.per_doubling) or file.dropout.anchor == "state_rate":
                why = f"its slope is 0, or anchor state_rate makes up for it: set detector.{slope}"
                yield UnreadKey(f"{path}.{name}.reference", why, (slope, "dropout.anchor"))


def _switched_off(file: DetectorFile) -> Iterator[UnreadKey]:
    false_positives, prefix = file.false_positives, "false_positives"
    switches: list[tuple[str, str, object]] = [
        (f"{prefix}.merge_overlap", f"{prefix}.merges", false_positives.merges),
        ("persistence.merge_s", f"{prefix}.merges", false_positives.merges),
        (f"{prefix}.split_aspect", f"{prefix}.splits", false_positives.splits),
        (
            f"{prefix}.persistence",
            f"{prefix}.persistence.share",
            false_positives.persistence and false_positives.persistence.share,
        ),
    ]
    if file.persistence.score is not None and len(file.labels) == 1:
        for name in ("class_s", "class_vessel_share"):
            why = "with a score it is that of the label, and there is one: set detector.persistence.score"
            yield UnreadKey(f"persistence.{name}", why, ("persistence.score", "labels"), is_dead=True)
    for name, state in file.states.items():
        path = f"states.{name}.confidence"
        switches.append((f"{path}.size_reference_px", f"{path}.size_slope", state.confidence.size_slope))
    for path, switch, value in switches:
        if value == 0:
            yield UnreadKey(path, f"{switch.rpartition('.')[2]} is 0: set detector.{switch}", (switch,), is_dead=True)
    if file.dropout.model == "confusion" and file.dropout.anchor != "none":
        why = "there is no effect with model confusion: set detector.dropout.model"
        yield UnreadKey("dropout.anchor", why, ("dropout.model",), is_dead=True)
