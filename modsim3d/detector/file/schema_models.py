"""The form of the models that a detector file may add to the plain chain: all of them are off unless given."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator

from modsim3d.detector.confidence import PrecisionRecall
from modsim3d.detector.dropout import ATTRIBUTES
from modsim3d.io.validation import MAX_NUMBER, NotNegative, Number, Positive, Probability, Strict, nearest

MAX_PER_IMAGE = 1000
"""False positives, which all take memory; a detector has a few."""
PerImage = Annotated[float, Field(strict=True, ge=0, le=MAX_PER_IMAGE)]
MIN_LIFETIME_S = 0.01
Lifetime = Annotated[float, Field(strict=True, ge=MIN_LIFETIME_S, le=MAX_NUMBER)]
Fraction = Annotated[float, Field(strict=True, ge=0, lt=1)]


def _ascending(value: list[float]) -> list[float]:
    if any(b <= a for a, b in itertools.pairwise(value)):
        raise ValueError(f"must ascend (got {', '.join(f'{number:g}' for number in value)})")
    return value


Edges = Annotated[list[Number], Field(min_length=1), AfterValidator(_ascending)]


class EffectSection(Strict):
    """Change of the odds of a miss by one attribute: a slope (`logistic`) or ranges (`table`)."""

    per_unit: Number | None = None
    per_doubling: Number | None = None
    reference: NotNegative | None = None
    edges: Edges | None = None
    odds: list[Positive] | None = None

    @model_validator(mode="after")
    def _one_form(self) -> EffectSection:
        slopes = [self.per_unit, self.per_doubling]
        if self.edges is not None or self.odds is not None:
            if any(value is not None for value in (*slopes, self.reference)):
                raise ValueError("give either per_unit or per_doubling with a reference, or edges with odds")
            if len(self.odds or []) != len(self.edges or []) + 1:
                raise ValueError(
                    f"has {len(self.edges or [])} edges and {len(self.odds or [])} odds: there must be one of odds more"
                )
        elif sum(value is not None for value in slopes) != 1 or self.reference is None:
            raise ValueError("give exactly one of per_unit and per_doubling, and a reference at which nothing changes")
        elif self.per_doubling is not None and self.reference == 0:
            raise ValueError("reference is 0, which nothing doubles from: it must be above 0 with per_doubling")
        return self


def _one_for_each_label(value: list[Any], info: ValidationInfo) -> list[Any]:
    labels: Sequence[str] = (info.context or {}).get("labels", ())
    if labels and len(value) != len(labels):
        raise ValueError(f"has {len(value)} entries, must have one for each of the labels {', '.join(labels)}")
    return value


class EffectsSection(Strict):
    """Effects of what a vessel looks like on its misses; those of a state replace the shared ones."""

    visible_fraction: EffectSection | None = None
    partly_hidden: EffectSection | None = None
    size_px: EffectSection | None = None
    distance_m: EffectSection | None = None
    intercept: Annotated[list[Number], AfterValidator(_one_for_each_label)] | None = None
    learned_log_odds: (
        Annotated[list[Annotated[list[Number], Field(min_length=1)]], AfterValidator(_one_for_each_label)] | None
    ) = None

    def effects(self) -> dict[str, EffectSection]:
        """Effects that are given."""
        given = {name: getattr(self, name) for name in ATTRIBUTES}
        return {name: effect for name, effect in given.items() if effect is not None}

    def misfit(self, model: str) -> str | None:
        """Problem of the effects under the name of the model of all of them; None if there is none."""
        hidden = self.partly_hidden
        if hidden is not None and hidden.per_doubling is not None:
            return "partly_hidden: is 0 or 1, which nothing doubles: it must have per_unit and a reference of 0 or 1"
        if self.learned_log_odds is not None and self.intercept is None:
            return "learned_log_odds goes with an intercept, which a miss_rate finds anew from them"
        if model == "confusion" and self.intercept is not None:
            return "model confusion has no intercept: choose model logistic or table"
        for name, effect in self.effects().items():
            if model == "confusion":
                return f"model confusion has no {name}: choose model logistic or table"
            if (effect.edges is not None) != (model == "table"):
                needed = "edges and odds" if model == "table" else "per_unit or per_doubling, and reference"
                return f"{name}: model {model} needs {needed}"
        return None


class DropoutSection(EffectsSection):
    """Effects on misses of what a vessel looks like."""

    model: Literal["confusion", "logistic", "table"] = "confusion"
    anchor: Literal["none", "state_rate"] = "none"

    @model_validator(mode="after")
    def _effects_fit(self) -> DropoutSection:
        misfit = self.misfit(self.model)
        if misfit is not None:
            raise ValueError(misfit)
        return self


class GatesSection(Strict):
    """Hard limits."""

    max_range_m: Positive | None = None
    min_box_px: Positive | None = None
    max_occlusion: Probability | None = None
    update_interval_s: Positive | None = None
    max_detections: Annotated[int, Field(strict=True, gt=0)] | None = None


class LatentScoreSection(Strict):
    """The number behind misses and confidence: shares of its variance, and the times in which some are forgotten."""

    vessel_share: Fraction = 0.0
    shares: list[Probability] = Field(default_factory=list)
    times_s: list[Positive] = Field(default_factory=list)

    @model_validator(mode="after")
    def _shares_fit(self) -> LatentScoreSection:
        if len(self.shares) != len(self.times_s):
            raise ValueError(f"has {len(self.shares)} shares and {len(self.times_s)} times_s: one belongs to each")
        total = self.vessel_share + sum(self.shares)
        if total > 1 + 1e-9:
            raise ValueError(f"vessel_share and shares sum to {total:g}, must not exceed 1")
        return self


class BoxMemorySection(Strict):
    """Memory of the components of box errors: shares of their variances, and the times in which some are forgotten,
    each for e_x, e_y, e_w, e_h and, where tails are heavy, for how large the errors are."""

    vessel_share: list[Fraction]
    shares: list[list[Probability]] = Field(default_factory=list)
    times_s: list[Positive] = Field(default_factory=list)

    @model_validator(mode="after")
    def _shares_fit(self) -> BoxMemorySection:
        if len(self.shares) != len(self.times_s):
            raise ValueError(
                f"has {len(self.shares)} lists of shares and {len(self.times_s)} times_s: one belongs to each"
            )
        for key, numbers in [("vessel_share", self.vessel_share), *(("shares", shares) for shares in self.shares)]:
            if len(numbers) not in (4, 5) or len(numbers) != len(self.vessel_share):
                raise ValueError(
                    f"{key} has {len(numbers)} numbers, must have one each for e_x, e_y, e_w, e_h, and may have one "
                    "for how large errors are: 4 in all lists, or 5"
                )
        totals = [sum(column) for column in zip(self.vessel_share, *self.shares, strict=True)]
        if max(totals) > 1 + 1e-9:
            raise ValueError(f"vessel_share and shares of a component sum to {max(totals):g}, must not exceed 1")
        return self


class PersistenceSection(Strict):
    """Correlation times, and shares of the noise that a vessel keeps; 0 is none."""

    class_s: NotNegative = 0.0
    box_s: NotNegative = 0.0
    confidence_s: NotNegative = 0.0
    merge_s: NotNegative = 0.0
    class_vessel_share: Fraction = 0.0
    box_vessel_share: Fraction = 0.0
    score: LatentScoreSection | None = None
    box: BoxMemorySection | None = None

    @model_validator(mode="after")
    def _one_memory(self) -> PersistenceSection:
        if self.score is not None and self.confidence_s:
            raise ValueError("confidence_s: with a score, confidence lasts as the score's parts do: leave it out")
        if self.box is not None and (self.box_s or self.box_vessel_share):
            raise ValueError("box_s, box_vessel_share: with a memory of each component, box, leave them out")
        return self


class SizeSection(Strict):
    """Size of false positives."""

    model: Literal["truth", "fixed", "lognormal"]
    px: tuple[Positive, Positive] | None = None
    log_std: NotNegative | None = None

    @model_validator(mode="after")
    def _complete(self) -> SizeSection:
        if (self.px is None) != (self.model == "truth"):
            raise ValueError("px [width, height] goes with model fixed or lognormal, and only there")
        if (self.log_std is None) != (self.model != "lognormal"):
            raise ValueError("log_std goes with model lognormal, and only there")
        return self


class PersistentSection(Strict):
    """False positives that stay for a while."""

    lifetime_s: Lifetime
    drift_px_s: NotNegative = 0.0
    share: Probability = 1.0


Four = Annotated[list[Number], Field(min_length=4, max_length=4)]


class OnVesselsSection(Strict):
    """False positives that lie on vessels."""

    share: Fraction
    lifetime_s: NotNegative = 0.0
    mean: Four
    std: Annotated[list[NotNegative], Field(min_length=4, max_length=4)]


def _density(value: list[list[float]]) -> list[list[float]]:
    if len({len(row) for row in value}) != 1 or not value[0]:
        raise ValueError("must have rows of one length")
    if not any(weight > 0 for row in value for weight in row):
        raise ValueError("must have a weight above 0")
    return value


class FalsePositiveKeys(Strict):
    """Properties of false positives besides their model."""

    rate: PerImage | None = None
    placement: Literal["uniform", "horizon_band", "density"] = "uniform"
    band_px: Positive | None = None
    density: Annotated[list[list[NotNegative]], Field(min_length=1), AfterValidator(_density)] | None = None
    far_half_px: Positive | None = None
    size: SizeSection | None = None
    persistence: PersistentSection | None = None
    on_vessels: OnVesselsSection | None = None
    duplicates: Fraction = 0.0
    merges: Probability = 0.0
    merge_overlap: Probability = 0.3
    splits: Fraction = 0.0
    split_aspect: Positive = 4.0


def _quantiles(value: list[float]) -> list[float]:
    if any(b < a for a, b in itertools.pairwise(value)):
        raise ValueError("must not fall: they are quantiles from 0 to 100 %")
    return value


class ScoreSection(Strict):
    """A distribution of confidence: normal, or by its quantiles."""

    alternatives: ClassVar = ((("mean", "std"), ("quantiles",)),)

    mean: Number | None = None
    std: NotNegative | None = None
    quantiles: Annotated[list[Probability], Field(min_length=2), AfterValidator(_quantiles)] | None = None

    @model_validator(mode="after")
    def _one_form(self) -> ScoreSection:
        normal = self.mean is not None and self.std is not None
        if normal == (self.quantiles is not None) or (self.mean is None) != (self.std is None):
            raise ValueError("give either mean and std, or quantiles")
        return self


def _text_keys(value: Any) -> Any:
    """YAML reads `true:` and `false:` as truth values and not as names."""
    if not isinstance(value, Mapping):
        return value
    return {{True: "true", False: "false"}.get(key, key) if isinstance(key, bool) else key: value[key] for key in value}


def _curve(value: list[tuple[float, float]]) -> list[tuple[float, float]]:
    recall = [point[0] for point in value]
    if recall[0] <= 0 or any(b <= a for a, b in itertools.pairwise(recall)):
        raise ValueError("recalls must ascend and be above 0")
    if any(precision <= 0 for _, precision in value):
        raise ValueError("precisions must be above 0")
    falls = PrecisionRecall.through(value).falls()
    if falls is not None:
        raise ValueError(
            f"precision rises so fast from recall {falls[0]:.3g} on that false positives would have to vanish: no "
            "detector has such a curve"
        )
    return value


Curve = Annotated[
    list[Annotated[tuple[Probability, Probability], Field()]], Field(min_length=1), AfterValidator(_curve)
]


class ConfidenceKeys(Strict):
    """Confidence: one normal distribution, two of any kind, or a precision-recall curve."""

    alternatives: ClassVar = ((("mean", "std"), ("true", "false"), ("precision_recall",)),)

    # Beyond 1 where nearly all are clipped; far beyond, they are in per cent.
    mean: Annotated[float, Field(ge=-10, le=10)] | None = None
    std: NotNegative | None = None
    true: ScoreSection | None = None
    false: ScoreSection | None = None
    precision_recall: Curve | None = None
    visibility_slope: NotNegative = 0.0
    size_slope: NotNegative = 0.0
    size_reference_px: Positive = 64.0

    @model_validator(mode="after")
    def _one_form(self) -> ConfidenceKeys:
        forms = [(self.mean, self.std), (self.true, self.false), (self.precision_recall,)]
        begun = [form for form in forms if any(part is not None for part in form)]
        if len(begun) != 1 or any(part is None for part in begun[0]):
            raise ValueError("give mean and std, or true and false, or precision_recall")
        if self.precision_recall and (self.visibility_slope or self.size_slope):
            raise ValueError("precision_recall already says how confidence is spread: leave the slopes out")
        return self


ConfidenceSection = Annotated[ConfidenceKeys, BeforeValidator(_text_keys)]


def _schedule(value: list[tuple[float, str | None]], info: ValidationInfo) -> list[tuple[float, str | None]]:
    _ascending([time_s for time_s, _ in value])
    states: Sequence[str] = (info.context or {}).get("states", ())
    for _, state in value:
        if states and state is not None and state not in states:
            raise ValueError(f"unknown state '{state}' ({nearest(state, states)})")
    return value


class PerformanceSection(Strict):
    """Sharing of the chain of states, and when a state is forced; null hands over to the chain again."""

    scope: Literal["shared", "per_camera"] = "shared"
    schedule: Annotated[list[tuple[NotNegative, str | None]], AfterValidator(_schedule)] = Field(default_factory=list)
