"""From labelled sets to a report: conditions, states, figures, the detector, and what matching does to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.boxes import iou
from modsim3d.errors import InputError, ModsimError
from modsim3d.learn.error_shares import error_shares
from modsim3d.learn.estimates import least_inflation
from modsim3d.learn.figures import Figures, figures
from modsim3d.learn.gate_bias import bias_of
from modsim3d.learn.labelled import LabelledSet
from modsim3d.learn.learned import Settings, learn
from modsim3d.learn.matching import Matched, Rule, match
from modsim3d.learn.states import StateMap, cluster, each_its_own, parse_sequence, parse_states, transitions_of
from modsim3d.learn.transitions import Transitions, count_transitions
from modsim3d.learn_report import Report


@dataclass(frozen=True)
class Asked:
    """What is wanted besides the settings of learning.

    Attributes:
        states: Texts such as `good=day,cloudy`.
        clusters: Number of states to make by F1.
        sequence: Text with a state a line.
        interval_s: Time between transitions.
        level: Of the intervals.
        beta: Of F-beta.
        bias: Whether to find what the matching does.
    """

    states: tuple[str, ...] = ()
    clusters: int | None = None
    sequence: str | None = None
    interval_s: float | None = None
    level: float = 0.95
    beta: float = 2.0
    bias: bool = False


def learn_detector(labelled: LabelledSet, settings: Settings, asked: Asked) -> Report:
    """Learn and report.

    Raises:
        ModsimError: There is no truth, or the states do not fit the conditions.
    """
    if asked.states and asked.clusters:
        raise ModsimError("give --state, which names the conditions of each state, or --states, which finds them")
    matched = match(labelled, settings.rule, settings.threshold)
    if not matched.sought.any():
        raise ModsimError("there is no truth that is to be found: nothing can be learned")
    by_label = match(labelled, Rule(least_iou=settings.rule.least_iou, by_label=True))
    f1 = {name: _f1(labelled, matched.pairs[0], matched.counts, matched.sought, k)
          for k, name in enumerate(labelled.conditions)}  # fmt: skip
    if asked.states:
        state_map = parse_states(asked.states, labelled.conditions)
    elif asked.clusters:
        seen = np.unique(labelled.images.condition)
        state_map = cluster({labelled.conditions[k]: f1[labelled.conditions[k]] for k in seen}, asked.clusters)
    else:
        state_map = each_its_own(labelled.conditions)
    state_map = StateMap({name: tuple(given) for name, given in state_map.states.items()})
    image_state = state_map.of_images(labelled.images, labelled.conditions)
    present = [bool(np.any(image_state == k)) for k in range(len(state_map.names))]
    if not all(present):
        kept = {name: state_map.states[name] for name, there in zip(state_map.names, present, strict=True) if there}
        state_map = StateMap(kept)
        image_state = state_map.of_images(labelled.images, labelled.conditions)
    transitions = _transitions(labelled, image_state, state_map, asked)
    learned = learn(labelled, state_map.names, image_state, transitions, settings)
    resampling = learned.resampling
    inflation = least_inflation(learned.observed, learned.columns)

    def of(name: str, images: np.ndarray) -> Figures:
        return figures(name, labelled, matched, by_label, resampling, images, asked.beta, inflation)

    conditions = [of(name, labelled.images.condition == k) for k, name in enumerate(labelled.conditions)
                  if np.any(labelled.images.condition == k)]  # fmt: skip
    conditions.sort(key=lambda each: -float(np.nan_to_num(each.columns["any F1"].estimate)))
    return Report(
        labelled=labelled,
        by_label=by_label,
        conditions=conditions,
        states=[of(name, image_state == k) for k, name in enumerate(state_map.names)],
        state_map=state_map,
        learned=learned,
        shares=error_shares(labelled, image_state >= 0, settings.rule.least_iou),
        bias=bias_of(learned, labelled, image_state, settings) if asked.bias else None,
        level=asked.level,
        beta=asked.beta,
        matched_by=str(settings.rule),
        remarks=(*labelled.notes, *_about_matches(labelled, matched, settings.rule, state_map.names, image_state)),
    )


_NEAR_THE_GATE, _MANY_NEAR = 0.1, 0.05
_ALMOST_ALL, _HARDLY_ANY = 0.8, 0.2


def _about_matches(
    labelled: LabelledSet, matched: Matched, rule: Rule, states: tuple[str, ...], image_state: np.ndarray
) -> list[str]:
    """What the matches themselves say against them."""
    remarks, (found, truth) = [], matched.pairs
    if not len(found):
        return ["nothing matches: are truth and detections of the same images, and boxes in pixels of the same size?"]
    shift = labelled.results.label[found] - labelled.annotations.label[truth]
    for step, where in ((1, "after"), (-1, "before")):
        if (shift == 0).mean() < _HARDLY_ANY and (shift == step).mean() > _ALMOST_ALL:
            remarks.append(
                f"{(shift == step).mean():.0%} of the matches have the label {where} that of the truth in the list of "
                f"categories: do results count from elsewhere (--category-offset {-step})?"
            )
    if rule.method in ("confidence", "optimal"):
        near = (
            iou(labelled.results.boxes_px[found], labelled.annotations.boxes_px[truth])
            < rule.least_iou + _NEAR_THE_GATE
        )
        state = image_state[labelled.annotations.image[truth]]
        for k, name in enumerate(states):
            share = float(near[state == k].mean()) if np.any(state == k) else 0.0
            if share > _MANY_NEAR:
                remarks.append(
                    f"{share:.0%} of the matches{f' in {name}' if len(states) > 1 else ''} have an IoU of less than "
                    f"{rule.least_iou + _NEAR_THE_GATE:.2g}: larger errors were cut off, and count as a miss and a "
                    "false detection each (--bias says how much that does; --match centre, at a distance that is "
                    "large against the errors, cuts off less)"
                )
    return remarks


def _f1(labelled: LabelledSet, found: np.ndarray, counts: np.ndarray, sought: np.ndarray, condition: int) -> float:
    """Of a condition, labels left aside."""
    here = labelled.images.condition == condition
    right = float(here[labelled.results.image[found]].sum())
    detected = float((counts & here[labelled.results.image]).sum())
    true = float((sought & here[labelled.annotations.image]).sum())
    return 2 * right / (detected + true) if detected + true else 0.0


def _transitions(labelled: LabelledSet, image_state: np.ndarray, state_map: StateMap, asked: Asked) -> Transitions:
    """From the text where it is given, else from the frames."""
    count = len(state_map.names)
    if asked.interval_s is not None and not asked.interval_s > 0:
        raise InputError("--interval", [f"must be above 0 (got {asked.interval_s:g})"])
    if asked.sequence is None:
        return transitions_of(labelled.images, image_state, count, asked.interval_s)
    sequence = parse_sequence(asked.sequence, state_map.names, "--sequence")
    return count_transitions([sequence], count, asked.interval_s)
