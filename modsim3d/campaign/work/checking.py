"""Checks a campaign before its first run, and says what its plan depends on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from modsim3d.campaign.keys import KNOWN, TIMES, CampaignFile, CampaignKeys, LabelledVideos, TrackerKeys
from modsim3d.campaign.plan import CAMERA, STATE, Case, Plan, PlannedRun, cases_of, count_conditions, value_at
from modsim3d.campaign.work.requirement_problems import requirement_problems, score_problems
from modsim3d.campaign.work.row import WORLD_SCORES, rules_of, search_problems, search_versions
from modsim3d.campaign.work.scenes import Scenes, checksums, detector_digest, digest, plan_digest, tracker_of, versions
from modsim3d.campaign.work.task import condition_problems, key_readings, tracker_problems
from modsim3d.core.errors import InputError, ModsimError, OutputError
from modsim3d.core.text import counted
from modsim3d.io.atomic_write import put_folder_in_place
from modsim3d.io.plugins import Plugin, changed_plugins
from modsim3d.io.validation import nearest, shown
from modsim3d.scene.reading import shipped_scenes
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.command import CommandTracker, argument_files
from modsim3d.tracking.trackers.world_interface import WorldTracker

MAX_CONDITIONS = 10_000  # each is read and checked before the first run, and is a row of the tables
MAX_RUNS = 5_000_000
_ELSEWHERE = {
    "seed": "seeds",
    "detector_seed": "seeds",
    "steps": "steps",
    "scene": "scenes",
    "scenes": "scenes",
    "tracker": "trackers",
    "trackers": "trackers",
}
"""Keys that cannot be varied, and the key of the campaign that is for it."""


@dataclass(frozen=True)
class ConditionFacts:
    """Facts about a condition before it is run."""

    scene: str  # name
    truth_sha256: str  # of the scene without its detector and seed
    detector_sha256: str
    truth_has_seed: bool  # whether the truth depends on the traffic seed
    traffic_has_seed: bool  # whether the traffic does; else the results are of this traffic only
    states: tuple[str, ...]  # names of the detector's performance states
    cameras: tuple[str, ...]  # names
    trackers: dict[str, dict[str, Any]]  # settings and versions of each, by its name in tables


@dataclass(frozen=True)
class CheckedCampaign:
    """A campaign that can be run."""

    file: CampaignFile
    plan: Plan
    facts: tuple[ConditionFacts, ...]
    content: dict[str, Any]  # of `plan.json`, with the checksums of files and plug-ins and the versions of packages
    sha256: str  # of all that decides the results
    notes: tuple[str, ...] = ()  # remarks on labels that were read


def checked(file: CampaignFile) -> CheckedCampaign:
    """Check a campaign: each condition with the first traffic seed, and the ends of the ranges of drawn values; scenes
    of labelled videos are written before. Raises InputError with every problem, and ModsimError if a library that it
    needs is not installed."""
    keys, source = file.keys, f"campaign {file.path}"
    packages = {**versions(), **search_versions(keys)}
    if too_large := [*_size_problems(keys)]:
        raise InputError(source, too_large)
    file, notes = _with_scenes(file)
    trackers = [
        tracker.model_copy(update={"files": argument_files(tracker.command, file.base)})
        if tracker.command is not None and tracker.files is None  # files that it makes are not its own
        else tracker
        for tracker in file.keys.trackers
    ]
    keys = file.keys.model_copy(update={"trackers": trackers})
    file = replace(file, keys=keys)
    plan, scenes = Plan.of(keys), Scenes(keys.steps, file.base, learned=keys.uncertainty == "learned")
    paths, plugins = set[Path](), set[Plugin]()
    wrong_keys = [*_vary_problems(keys)]
    problems = [*_problems(keys), *wrong_keys, *_twice(plan), *_scene_problems(file)]
    valid_plan = None if wrong_keys else _with_known_trackers(plan, file.base, problems)
    facts = [*_facts_of_all(valid_plan, scenes, paths, plugins, problems)] if valid_plan else []
    if len(facts) == len(plan.conditions):
        problems += requirement_problems(plan, [{STATE: fact.states, CAMERA: fact.cameras} for fact in facts])
    else:  # no more can be said of the requirements yet
        for place, requirement in enumerate(keys.require):
            problems += score_problems(requirement, f"require[{place}]")
    if not problems:
        problems += _space_problems(plan, file.base)
    own = {plugin.key: dict(plugin.files) for plugin in sorted(plugins, key=lambda plugin: plugin.key)}
    problems += changed_plugins(own, "Python loaded it: start it again")
    if problems:
        raise InputError(source, dict.fromkeys(problems))
    pairs = zip(plan.conditions, facts, strict=True)
    content = {
        "campaign": keys.model_dump(mode="json", by_alias=True),
        "conditions": [{"values": condition.values, **asdict(fact)} for condition, fact in pairs],
        "files": checksums(paths, file.base),
        "plugins": own,
        "versions": packages,
    }
    return CheckedCampaign(file, plan, tuple(facts), content, plan_digest(content), notes)


_KEYS = {
    r"--set detector\.(\S+?)=(\S+)": r"detector.\1: \2",
    r"--labels A,B,\.\.\.": "labels: [A, B, ...]",
    r"--horizon ROW, or X1,Y1,X2,Y2": "horizon: ROW, or [X1, Y1, X2, Y2],",
    r"--confidence-scale ([^\s,]+),(\S+)": r"confidence_scale: [\1, \2]",
    r"--frame-rate(?: HZ)?\b": "frame_rate_hz",
    r"--image-size\b": "image_size_px",
    r"--skip-bad\b": "skip_bad: true",
    r"--first-frame\b": "first_frame",
    r"--confidence-scale\b": "confidence_scale",
    r"--(labels|horizon|detections|detector)\b": r"\1",
}
"""Keys of a campaign file by the options that errors of a reader name, as regular expressions."""


def _with_scenes(file: CampaignFile) -> tuple[CampaignFile, tuple[str, ...]]:
    """The campaign with a scene in place of each of its labelled videos, and remarks on them. A scene is written beside
    the file, in a folder whose name has its checksum, so that older campaigns keep theirs. Raises InputError if labels
    are wrong, or it cannot be written."""
    scenes, notes, beside = list(file.keys.scenes), list[str](), file.path.resolve().with_suffix("")
    for place, videos in file.videos.items():
        scene, remarks = _scene_of(videos, file)
        notes += [f"{videos.called}: {note}" for note in remarks]
        folder = beside.with_name(f"{beside.name}_scenes") / f"{videos.called}-{scene.copy.sha256()[:12]}"
        try:
            if not folder.is_dir():
                with put_folder_in_place(folder, "*") as partial:
                    scene.copy.write(partial)
        except (OSError, OutputError) as error:
            hint = f"a scene is made of them in {folder}, which cannot be written ({error}): copy the campaign file"
            raise InputError(f"scenes: {videos.truth}", [f"{hint} and the labels to a folder of your own"]) from None
        scenes[place] = str((folder / f"{videos.called}.json").relative_to(file.base))
    return replace(file, keys=file.keys.model_copy(update={"scenes": scenes})), tuple(notes)


def _scene_of(videos: LabelledVideos, file: CampaignFile) -> tuple[Scene, tuple[str, ...]]:
    from modsim3d.formats.detect_truth import labelled_scene  # few campaigns read labels
    from modsim3d.formats.reading.builder import ReadOptions

    detector, settings = videos.detector, {k: v for k, v in file.keys.settings.items() if k.startswith("detector.")}
    if detector and (file.base / detector).is_file():
        detector = str(file.base / detector)
    try:
        return labelled_scene(
            file.base / videos.truth,
            videos.called,
            options=ReadOptions(
                (),
                videos.image_size_px,
                videos.skip_bad,
                videos.frame_rate_hz,
                confidence_scale=videos.confidence_scale,
                first_frame=videos.first_frame,
            ),
            detections=None if videos.detections is None else file.base / videos.detections,
            detector=detector,
            settings=settings,
            labels=videos.labels,
            horizon=videos.horizon,
        )
    except InputError as error:
        fault = error.reworded({rf"(?<!\S){option}": key for option, key in _KEYS.items()})
        raise InputError(f"scenes: {videos.truth}", [f"{fault.source}: {line}" for line in fault.problems]) from None
    except ModsimError as error:
        raise InputError(f"scenes: {videos.truth}", [str(error)]) from None


def _size_problems(keys: CampaignKeys) -> Iterator[str]:
    count = count_conditions(keys.scenes, keys.vary)
    runs = count * keys.seeds.traffic * keys.seeds.detector * len(keys.trackers)
    if count > MAX_CONDITIONS:
        yield (
            f"vary: {count:,} conditions, and at most {MAX_CONDITIONS:,} are possible: take fewer values, pairs in "
            "place of grid, or draw values with uniform or latin_hypercube"
        )
    elif runs > MAX_RUNS:
        yield (
            f"{runs:,} runs, and at most {MAX_RUNS:,} are possible: {counted(count, 'condition')} × "
            f"{counted(keys.seeds.traffic, 'traffic seed')} × {counted(keys.seeds.detector, 'detector seed')} × "
            f"{counted(len(keys.trackers), 'tracker')}"
        )


def _scene_problems(file: CampaignFile) -> Iterator[str]:
    shipped = shipped_scenes()
    for place, scene in enumerate(file.keys.scenes):
        if scene not in shipped and not (file.base / scene).exists():
            yield (
                f"scenes[{place}]: {file.base / scene}: no such file, and no shipped scene is called '{scene}' "
                f"({nearest(scene, shipped)})"
            )
    names = [Path(scene).stem for scene in file.keys.scenes]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        yield f"scenes: two are called '{twice[0]}', and tables could not tell them apart"


def _with_known_trackers(plan: Plan, base: Path, problems: list[str]) -> Plan:
    """The plan with the trackers that are there and take their settings; those of the others go to the problems."""
    usable = []
    for place, tracker in enumerate(plan.keys.trackers):
        try:
            tracker_of(tracker, {}, None, base).origin  # noqa: B018
            usable.append(tracker)
        except ModsimError as error:
            problems += tracker_problems(place, error)
    trackers = usable or [TrackerKeys(tracker="reference")]
    return replace(plan, keys=plan.keys.model_copy(update={"trackers": trackers}))


def _facts_of_all(
    plan: Plan, scenes: Scenes, paths: set[Path], plugins: set[Plugin], problems: list[str]
) -> Iterator[ConditionFacts]:
    """Facts about the conditions that can be run. The files and plug-ins that they are made of are added to those
    given, and what is wrong with the others to the problems."""
    first = [plan.run(place * plan.runs_by_seed // len(plan.conditions)) for place in range(len(plan.conditions))]
    ends = [replace(first[0], condition=first[0].condition.with_values(values)) for values in _ends(plan.keys)]
    missing = {
        scene
        for place, scene in enumerate(plan.keys.scenes)
        if any(p.startswith(f"scenes[{place}]:") for p in problems)
    }
    named, readings = plan.keys.search.over if plan.keys.search else (), dict[str, list[str]]()
    for place, run in enumerate((*first, *ends)):
        if run.condition.scene in missing:
            continue
        try:
            facts = _facts(run, plan, scenes, paths, plugins)
        except ModsimError as error:
            problems += condition_problems(run.condition, error, "search.over" if plan.keys.search else "vary")
        else:
            detector = scenes.of(run.condition, run.traffic_seed, run.detector_seed).detector
            for key, problem in key_readings(run.condition, detector, named):
                readings.setdefault(key, []).append(problem)
            if place < len(first):
                yield facts
    problems += [texts[0] for texts in readings.values() if all(texts)]


def _ends(keys: CampaignKeys) -> Iterator[dict[str, Any]]:
    """Values at the ends of each range that is drawn from or searched, and each choice, a key at a time."""
    drawn = [factor.ranges for factor in keys.vary]
    for ranges in (*drawn, keys.search.over if keys.search else {}):
        for key, span in ranges.items():
            for value in span.choices if span.choices is not None else (value_at(span, 0.0), value_at(span, 1 - 1e-12)):
                yield {key: value}


def _problems(keys: CampaignKeys) -> Iterator[str]:
    labels = [tracker.label for tracker in keys.trackers]
    if twice := sorted({label for label in labels if labels.count(label) > 1}):
        yield f"trackers: two are called '{twice[0]}': give one another name"
    if keys.stop == "sequential" and any(factor.latin_hypercube for factor in keys.vary):
        yield (
            "stop: sequential needs draws that do not depend on each other, and those of latin_hypercube do: use "
            "uniform, or stop: once"
        )
    if keys.stop == "sequential" and all(requirement.of_time for requirement in keys.require):
        other = "those on what runs took do not repeat, and decide nothing" if keys.require else "there is no require"
        yield f"stop: sequential ends when the requirements are decided, and {other}"
    sure = sorted({requirement.confidence for requirement in keys.require})
    if keys.level == "family" and len(sure) > 1:
        levels = " and ".join(f"{level:g}" for level in sure)
        yield f"level: family has one confidence for all requirements, and these have {levels}"
    yield from search_problems(keys)
    try:
        rules_of(keys.score)
    except ModsimError as error:
        yield f"score: {error}"


def _vary_problems(keys: CampaignKeys) -> Iterator[str]:
    names = [key for factor in keys.vary for key in _keys_of(factor)]
    for key in dict.fromkeys(names):
        if names.count(key) > 1:
            yield f"vary: '{key}' is varied by two factors: put its values into one"
        if key in _ELSEWHERE:
            yield f"vary: '{key}' cannot be varied here: the key {_ELSEWHERE[key]} of the campaign is for that"
    for key in keys.settings:
        if key in names:
            yield f"set: '{key}' is in vary too"
        if key in _ELSEWHERE:
            yield f"set: '{key}' cannot be set here: the key {_ELSEWHERE[key]} of the campaign is for that"


def _twice(plan: Plan) -> Iterator[str]:
    """The first condition that is another one again: its runs would count twice."""
    seen: dict[str, int] = {}
    for number, condition in enumerate(plan.conditions):
        before = seen.setdefault(digest(condition.scene, condition.values), number)
        if before != number and condition.values:
            values = ", ".join(f"{key} {shown(value)}" for key, value in condition.values.items())
            yield f"vary: conditions {before} and {number} are the same ({values}): leave one out"
            return


def _keys_of(factor: Any) -> Iterator[str]:
    if factor.conditions is not None:
        yield from dict.fromkeys(key for values in factor.conditions for key in values)
    yield from factor.grid or factor.pairs or factor.ranges


def _facts(run: PlannedRun, plan: Plan, scenes: Scenes, paths: set[Path], plugins: set[Plugin]) -> ConditionFacts:
    """Facts about a condition; the files and plug-ins that it is made of are added to those given."""
    scene = scenes.of(run.condition, run.traffic_seed, run.detector_seed)
    _check_labels(scene, run.condition.of_detector(), plan.keys)
    _check_lookout(scene, plan.keys)
    paths |= scenes.files(run.condition, scene)
    settings = run.condition.of_tracker()
    named = {tracker.label: tracker_of(tracker, settings, scene.name, scenes.folder) for tracker in plan.keys.trackers}
    for entry in named.values():
        if isinstance(entry.tracker, CommandTracker):
            paths |= {path.resolve() for path in entry.tracker.paths().values()}
    plugins.update(scene.plugins, (entry.plugin for entry in named.values() if entry.plugin))
    return ConditionFacts(
        scene.name,
        scene.copy.truth_sha256(),
        detector_digest(scene.detector),
        scene.truth_has_seed,
        scene.traffic_has_seed,
        tuple(state.name for state in scene.detector.states),
        tuple(camera.name for camera in scene.cameras),
        {label: vars(entry.origin) for label, entry in named.items()},
    )


def _space_problems(plan: Plan, base: Path) -> Iterator[str]:
    """Scores of tracks in the images that are required of trackers in the world, and the reverse. Where the tracks of a
    program are is not known before it runs."""
    keys, places = plan.keys, ("in the images", "in the world")
    trackers = [tracker_of(entry, {}, None, base).tracker for entry in keys.trackers]
    world = [None if isinstance(tracker, CommandTracker) else isinstance(tracker, WorldTracker) for tracker in trackers]
    asked = {
        (f"require[{place}].score", requirement.score): cases_of(plan, requirement)
        for place, requirement in enumerate(keys.require)
    }
    if keys.search is not None:
        asked["search", keys.search.minimise or keys.search.maximise or ""] = [Case(0, 0)]
    for (where, score), cases in asked.items():
        of_world = score in WORLD_SCORES
        able = [entry.label for entry, its in zip(keys.trackers, world, strict=True) if its in (None, of_world)]
        named = dict.fromkeys(at for case in cases for at in (case.tracker, case.minus) if at is not None)
        for label in (keys.trackers[at].label for at in named if score not in (KNOWN, *TIMES)):
            if label not in able:
                hint = f": name those that it is about, as in where: {{tracker: [{', '.join(able)}]}}" if able else ""
                yield f"{where}: {score} is of tracks {places[of_world]}, and those of {label} are not{hint}"


def _check_lookout(scene: Scene, keys: CampaignKeys) -> None:
    """Raise ModsimError where a lookout requirement is about no vessel of a scene."""
    if keys.lookout and not scene.own_ships:
        raise ModsimError(f"{scene.title}: no vessel carries a camera, so known_at_m has no own ship: leave it out")
    for label in (entry.kind.label for entry in keys.require if entry.kind and entry.kind.label):
        if label not in scene.detector.labels:
            hint = nearest(label, scene.detector.labels)
            raise ModsimError(f"{scene.title}: of.label of known_at_m: there is no label {shown(label)} ({hint})")


def _check_labels(scene: Scene, of_detector: Mapping[str, Any], keys: CampaignKeys) -> None:
    """Raise ModsimError where seeds or settings of a scene of labels would repeat what is the same."""
    labels = scene.labels
    if labels is None:
        return
    if scene.traffic_has_seed and labels.videos < keys.seeds.traffic:
        videos = counted(labels.videos, "video")
        raise ModsimError(
            f"{scene.title}: has {videos}, too few for {keys.seeds.traffic} traffic seeds: each shows one"
        )
    if labels.detections is not None and (keys.seeds.detector > 1 or of_detector):
        raise ModsimError(
            f"{scene.title}: has the detections of a real detector, which no seed and no key of a detector changes: "
            "leave them out, or give a detector in place of the detections"
        )
