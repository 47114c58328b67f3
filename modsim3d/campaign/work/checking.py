"""Checks a campaign before its first run, and says what its plan depends on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modsim3d.campaign.file.keys import CampaignKeys, Requirement
from modsim3d.campaign.file.reading import CampaignFile
from modsim3d.campaign.plan.plan import Plan, PlannedRun
from modsim3d.campaign.work.digests import detector_digest, digest, versions
from modsim3d.campaign.work.files import checksums
from modsim3d.campaign.work.requirement_problems import judging_problems
from modsim3d.campaign.work.row import SCORES, rules_of
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.search_checks import middle_run, search_problems
from modsim3d.errors import InputError, ModsimError
from modsim3d.inputs.validation import nearest
from modsim3d.tracking.trackers.registry import named_tracker


@dataclass(frozen=True)
class ConditionFacts:
    """What is known of a condition before it is run.

    Attributes:
        scene: Name of the scene.
        truth_sha256: Checksum of the scene without its detector and seed.
        detector_sha256: Checksum of the detector.
        truth_has_seed: Whether the truth depends on the traffic seed.
        traffic_has_seed: Whether the traffic does; else the results are of this traffic only.
        states: Names of the detector's performance states.
        cameras: Names of the cameras.
        trackers: Each tracker's name in tables, with its settings and versions.
    """

    scene: str
    truth_sha256: str
    detector_sha256: str
    truth_has_seed: bool
    traffic_has_seed: bool
    states: tuple[str, ...]
    cameras: tuple[str, ...]
    trackers: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class CheckedCampaign:
    """A campaign that can be run.

    Attributes:
        file: The file.
        plan: Its plan.
        facts: What is known of each condition.
        files: Checksum of each file that scenes and detectors are made of, see `files`.
        versions: Version of every package that decides the results.
        sha256: Checksum of all that decides the results.
    """

    file: CampaignFile
    plan: Plan
    facts: tuple[ConditionFacts, ...]
    files: dict[str, str]
    versions: dict[str, str]
    sha256: str


def checked(file: CampaignFile) -> CheckedCampaign:
    """Check a campaign with the first traffic seed of each condition.

    Raises:
        InputError: With every problem.
    """
    plan, problems, facts = Plan.of(file.keys), list(_problems(file.keys)), []
    if problems:
        raise InputError(f"campaign {file.path}", problems)
    scenes = Scenes(file.keys.steps, file.base, learned=file.keys.uncertainty == "learned")
    paths: set[Path] = set()
    for index, values in enumerate(plan.conditions):
        try:
            facts.append(
                _facts(plan.run(index * plan.keys.seeds.detector * len(plan.keys.trackers)), plan, scenes, paths)
            )
        except InputError as error:
            said = ", ".join(f"{key} {value}" for key, value in values.values.items()) or "as it is"
            problems += [f"{values.scene} ({said}): {error.source}: {problem}" for problem in error.problems]
        except ModsimError as error:
            problems.append(f"{values.scene}: {error}")
    if not problems and (middle := middle_run(plan)) is not None:
        try:
            _facts(middle, plan, scenes)
        except InputError as error:
            problems += [f"search.over, at its middle: {error.source}: {problem}" for problem in error.problems]
        except ModsimError as error:
            problems.append(f"search.over, at its middle: {error}")
    if problems:
        raise InputError(f"campaign {file.path}", dict.fromkeys(problems))
    problems = [*_requirement_problems(plan, facts)]
    if problems:
        raise InputError(f"campaign {file.path}", problems)
    content = file.keys.model_dump(mode="json", by_alias=True, exclude={"keep"})  # which decides no row
    packages = versions()
    sha256 = digest(content, [vars(each) for each in facts], packages)
    return CheckedCampaign(file, plan, tuple(facts), checksums(paths, file.base), packages, sha256)


def _problems(keys: CampaignKeys) -> Iterator[str]:
    """What is wrong with the keys together."""
    labels = [tracker.label for tracker in keys.trackers]
    if twice := sorted({label for label in labels if labels.count(label) > 1}):
        yield f"trackers: two are called '{twice[0]}': give one another name"
    found = [key for factor in keys.vary for key in _keys_of(factor)]
    if twice := sorted({key for key in found if found.count(key) > 1}):
        yield f"vary: '{twice[0]}' is varied twice"
    for key in found:
        if key in ("seed", "detector_seed", "steps", "scene", "tracker"):
            yield f"vary: '{key}' cannot be varied: the keys seed, seeds, steps, scenes and trackers are for that"
    if keys.stop == "sequential" and any(factor.latin_hypercube for factor in keys.vary):
        yield (
            "stop: sequential needs draws that do not depend on each other, and those of latin_hypercube do: use "
            "uniform, or stop: once"
        )
    if keys.stop == "sequential" and not keys.require:
        yield "stop: sequential ends when the requirements are decided, and there is no require"
    yield from search_problems(keys)
    try:
        rules_of(keys.score)
    except ModsimError as error:
        yield f"score: {error}"


def _keys_of(factor: Any) -> Iterator[str]:
    if factor.conditions is not None:
        yield from dict.fromkeys(key for values in factor.conditions for key in values)
    yield from factor.grid or factor.pairs or factor.latin_hypercube or factor.uniform or ()


def _facts(run: PlannedRun, plan: Plan, scenes: Scenes) -> ConditionFacts:
    scene = scenes.of(run.condition, run.traffic_seed, run.detector_seed)
    paths |= scenes.files(run.condition, scene)
    settings = run.condition.of_tracker()
    trackers = {
        each.label: vars(named_tracker(each.tracker, {**each.settings, **settings}, scene.name).origin)
        for each in plan.keys.trackers
    }
    return ConditionFacts(
        scene.name,
        scene.copy.truth_sha256(),
        detector_digest(scene.detector),
        scene.truth_has_seed,
        scene.traffic_has_seed,
        tuple(state.name for state in scene.detector.states),
        tuple(camera.name for camera in scene.cameras),
        trackers,
    )


def _requirement_problems(plan: Plan, facts: list[ConditionFacts]) -> Iterator[str]:
    labels = [tracker.label for tracker in plan.keys.trackers]
    states = {state for each in facts for state in each.states}
    for place, requirement in enumerate(plan.keys.require):
        where = f"require[{place}]"
        if requirement.score not in SCORES:
            yield f"{where}.score: there is no score '{requirement.score}' ({nearest(requirement.score, SCORES)})"
        yield from _where_problems(requirement, where, plan, labels, states)
        yield from judging_problems(requirement, where, plan, facts)


def _where_problems(
    requirement: Requirement, where: str, plan: Plan, labels: list[str], states: set[str]
) -> Iterator[str]:
    known = ["tracker", "scene", "state", *plan.parameters]
    for key, value in requirement.where.items():
        values = value if isinstance(value, list) else [value]
        if key not in known:
            yield f"{where}.where.{key}: is not varied in this campaign ({nearest(key, known)})"
            continue
        possible: set[Any] = set(labels) if key == "tracker" else states
        if key == "tracker" or (key == "state" and "state" not in plan.parameters):
            for each in values:
                if each not in possible:
                    yield f"{where}.where.{key}: there is no '{each}' ({nearest(str(each), sorted(possible))})"
