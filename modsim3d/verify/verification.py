"""Does a run obey its detector file?"""

from collections.abc import Collection, Mapping

from modsim3d.detector.chain import CONFUSION, MARKOV_CHAIN, DetectorPart, used_models
from modsim3d.detector.model import DetectorModel
from modsim3d.verify.box_error_checks import fit_checks, state_fits
from modsim3d.verify.class_checks import EFFECT_CHECKS, class_checks
from modsim3d.verify.confidence_checks import SCORE_CHECKS, confidence_checks
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.error_parameters import LIKELIHOODS
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.false_positive_checks import RATE_CHECKS, false_positive_checks
from modsim3d.verify.independence_checks import independence_checks
from modsim3d.verify.parameters import Parameter, Verification, judge
from modsim3d.verify.state_checks import state_checks

CHECKED: Mapping[DetectorPart, Collection[str]] = {
    DetectorPart.STATE: {MARKOV_CHAIN},
    DetectorPart.CLASS: {CONFUSION} | EFFECT_CHECKS.keys(),
    DetectorPart.BOX_ERROR: LIKELIHOODS.keys(),
    DetectorPart.FALSE_POSITIVES: RATE_CHECKS.keys(),
    DetectorPart.CONFIDENCE: SCORE_CHECKS.keys(),
}
"""The models of each part that have checks, by the names in `detector.chain.MODELS`."""


def verify_evidence(model: DetectorModel, evidence: Evidence, table: MomentTable | None = None) -> Verification:
    """Hold what a run shows against a detector's parameters.

    The table keeps expectations of box errors: give it to further calls over the same truth to save most of their work.
    """
    fits = state_fits(model, evidence, table or MomentTable())
    # In the order in which the detector works.
    parameters = [
        *state_checks(model, evidence),
        *class_checks(model, evidence),
        *fit_checks(model, evidence, fits),
        *false_positive_checks(model, evidence),
        *confidence_checks(model, evidence),
        *independence_checks(model, evidence, [fit for fit in fits.values() if fit is not None]),
    ]
    return judge([*parameters, *unchecked(model)])


def unchecked(model: DetectorModel) -> list[Parameter]:
    """A row for each model that the detector uses and no check knows."""
    return [
        Parameter(used.key, used.part, None, state=used.state, note=f"no check for model '{used.name}'", checked=False)
        for used in used_models(model)
        if used.name not in CHECKED[used.part]
    ]
