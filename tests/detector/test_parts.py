"""Every model of every part is registered once; `verify` and `learn` treat it or say that they do not."""

from collections.abc import Mapping
from typing import Any, cast, get_args

import numpy as np
import pytest

from modsim3d.core.arrays import Array
from modsim3d.detector.chain import MODELS, DetectorPart, model_name, used_models
from modsim3d.detector.draws import Normal, StudentT
from modsim3d.detector.false_positives import FALSE_POSITIVE_MODELS, FalsePositiveRates, FrameCounts, PerImage, RateKey
from modsim3d.detector.file.reading import parse_detector
from modsim3d.learn.learned_detector import LEARNERS, models_and_learners
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.parameters import UNCHECKED
from modsim3d.verify.verification import CHECKED, unchecked, verify_evidence
from tests.detector.detector_builders import detector, make_frames, one_state_data, steady_targets
from tests.detector_variants import CHANGES, variant

DRAWING = {
    **{DetectorPart.STATE: ("at",), DetectorPart.CLASS: ("classify", "of"), DetectorPart.BOX_ERROR: ("scales",)},
    **{DetectorPart.FALSE_POSITIVES: ("draw",), DetectorPart.CONFIDENCE: ("at",)},
}
WITHOUT_CHECKS: set[tuple[DetectorPart, str]] = set()
WITHOUT_LEARNER = {(DetectorPart.CLASS, "table"), (DetectorPart.FALSE_POSITIVES, "thesis")}


def test_every_registered_model_is_drawn_checked_and_learned_or_named_and_another_an_error():
    assert set(MODELS) == set(CHECKED) == set(LEARNERS) == set(DetectorPart)
    assert all(MODELS.values())
    assert Normal().extra_normals == 0 < StudentT(3.0).extra_normals  # numbers drawn beside the four errors
    assert {each.rate_key for each in FALSE_POSITIVE_MODELS.values()} == {*get_args(RateKey)}
    for part, name in ((part, name) for part, models in MODELS.items() for name in models):
        assert any(hasattr(MODELS[part][name], method) for method in DRAWING[part]), (part, name)
        assert (name in CHECKED[part]) != ((part, name) in WITHOUT_CHECKS), (part, name)
        assert (name in LEARNERS[part]) != ((part, name) in WITHOUT_LEARNER), (part, name)
        (learner,) = [each for *model, each in models_and_learners() if model == [part, name]]
        assert (learner is None) == ((part, name) in WITHOUT_LEARNER), (part, name)
    for name in CHANGES:
        used = list(used_models(parse_detector(variant(name))))
        assert {each.part for each in used} == set(DetectorPart), name
        assert all(each.name in MODELS[each.part] for each in used), name
    model = parse_detector(one_state_data())
    assert [each.key for each in used_models(model)][-1] == "states.only.confidence"  # of true and of false ones alike
    assert model.in_words() in repr(model) and model.in_words() in model._repr_html_()
    with pytest.raises(LookupError, match=r"str is not registered: known are normal, quantiles"):
        model_name(cast(Mapping[str, type], MODELS[DetectorPart.CONFIDENCE]), "uniform")


class EverySecondFrame(PerImage):
    """A model that nobody has checks for."""

    def means(self, rates: FalsePositiveRates, frames: FrameCounts) -> Array:
        return super().means(rates, frames) * (np.arange(len(frames.states)) % 2)


def test_models_and_parts_of_states_without_checks_are_listed_as_unchecked(monkeypatch):
    monkeypatch.setitem(cast(dict[str, Any], FALSE_POSITIVE_MODELS), "fourth", EverySecondFrame())
    sizes = {"model": "fixed", "px": [20, 10]}
    data = one_state_data() | {"false_positives": {"model": "fourth", "rate": 2.0, "size": sizes}}
    model, frames = parse_detector(data), make_frames(200)
    targets = steady_targets(200, 2, [100, 100, 300, 200])
    evidence = Evidence.of([CameraEvidence(frames, targets, detector(model).detect(frames, targets))])
    assert evidence.frames.n_false[::2].sum() == 0 < evidence.frames.n_false[1::2].sum()
    verdicts = verify_evidence(model, evidence).verdicts
    (verdict,) = [each for each in verdicts if each.verdict == UNCHECKED]
    parameter = verdict.parameter
    assert (parameter.name, parameter.group) == ("false_positives.model", DetectorPart.FALSE_POSITIVES)
    assert "'fourth'" in parameter.note
    names = [each.parameter.name for each in verdicts]
    assert not [name for name in names if "false discovery rate" in name or "false_positives_per_image" in name]
    model = parse_detector(variant("plain"))
    for part in (DetectorPart.BOX_ERROR, DetectorPart.CONFIDENCE):
        with monkeypatch.context() as patch:
            patch.setitem(CHECKED, part, frozenset())
            found = [(parameter.state, parameter.group) for parameter in unchecked(model)]
        assert found == [(state.name, part) for state in model.states]
