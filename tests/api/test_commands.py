"""Commands and functions: what the one can do, the other can, and errors of functions name arguments."""

import inspect
from pathlib import Path

import pytest

import modsim3d
from modsim3d.cli.learn import learn_command
from modsim3d.cli.learn_voyage import learn_voyage_command
from modsim3d.cli.main import COMMANDS
from modsim3d.core.errors import with_arguments
from tests.api.test_names import ELSEWHERE

FUNCTIONS = {
    "run": "run_scene",
    "detect": "detect_run detect_truth",
    "stream": "simulate_frames",  # its lines are for programs that are not written in Python
    "scenes": "shipped_scenes",
    "report": "report",
    "view film": "view_film",
    "view frame": "view_frame",
    "view map": "view_map",
    "view sheet": "view_sheet",
    "track": "track_run",
    "score": "score_run",
    "campaign run": "run_campaign search_campaign",
    "campaign plan": "plan_campaign",
    "campaign status": "open_campaign",
    "campaign table": "open_campaign",  # whose result has `means`
    "campaign report": "report_campaign",
    "campaign reproduce": "reproduce_run",
    "check scene": "check_scene load_detector plan_campaign",
    "check run": "verify_run",
    "check truth": "check_truth",
    "check repeat": "check_repeat",
    "ais": "ais",
    "learn": "learn_detector learn_from_figures guess_detector",
    "learn-voyage": "learn_voyage",
    "export": "export export_rerun",
}
OTHER_NAMES = {
    "runs": "run",
    "condition": "conditions",
    "time_step": "interval_s",
    "image_size": "image_size_px",
    "frame_rate": "frame_rate_hz",
    "no_check": "check",
    "detections": "log",
    "stale": "stale_s",
}
"""Arguments of `learn_detector` and `learn_voyage` by the parameters of the commands."""
NOT_IN_PYTHON = {
    **dict.fromkeys(("context", "out", "overwrite"), "arguments of LearnResult.write"),
    "from_figures": "a function of its own, learn_from_figures",
    **dict.fromkeys(("detector", "from_condition", "to_condition"), "a function of its own, guess_detector"),
    "write_scene": "registered[0].registration.scene_of(scene) is the scene",
    **dict.fromkeys(("log_start", "images", "frame_rate_hz", "category_offset", "skip_bad"), "in LogOptions"),
    **dict.fromkeys(("confidence_scale", "labels"), "in LogOptions"),
    **dict.fromkeys(("sequence", "interval_s"), "a voyage has its states in time already"),
}


def test_every_command_has_a_function() -> None:
    assert [name for _, name, _, _ in COMMANDS] == list(FUNCTIONS)
    assert {word for words in FUNCTIONS.values() for word in words.split()} <= set(modsim3d.__all__)


@pytest.mark.parametrize(("command", "function", "more"), [
    (learn_command, modsim3d.learn_detector, set()),
    (learn_voyage_command, modsim3d.learn_voyage, {"registration", "log_options"}),
])  # fmt: skip
def test_functions_that_learn_have_the_options_of_the_command(command, function, more) -> None:
    options = {OTHER_NAMES.get(name, name) for name in inspect.signature(command).parameters}
    if function is modsim3d.learn_detector:
        options = {"detections" if name == "log" else name for name in options}
    own = set(inspect.signature(function).parameters)
    assert options - own <= set(NOT_IN_PYTHON)
    assert own - options == {"least_iou", "most_distance_px", *more}  # the first two are in the text of --match


WRONG = {
    "run_scene": lambda run: modsim3d.run_scene(modsim3d.load_scene("simulation_1", steps=2), run),
    "load_scene": lambda run: modsim3d.load_scene("simulation_1", settings={"waves.levle": 1}),
    "load_scene state": lambda run: modsim3d.load_scene("simulation_1", state_from="conditions"),
    "simulate_frames": lambda run: list(modsim3d.simulate_frames(modsim3d.load_scene("simulation_1", state="none"))),
    "detect_run": lambda run: modsim3d.detect_run(run, run.parent / "x", settings={"waves.level": "large"}),
    "detect_truth": lambda run: modsim3d.detect_truth(run / "none.txt", run.parent / "x", detector="thesis", seed=-1),
    "labelled_video": lambda run: modsim3d.labelled_video(run / "run.json").__enter__(),
    "open_run": lambda run: modsim3d.open_run(run / "run.json"),
    "track_run": lambda run: modsim3d.track_run(run, run.parent / "x", tracker="srot"),
    "score_run": lambda run: modsim3d.score_run(run, run, gospa_c=-1.0),
    "score_run cameras": lambda run: modsim3d.score_run(run, run, cameras=["nobody"]),
    "learn_detector": lambda run: modsim3d.learn_detector(run=run, states=9),
    "learn_detector interval": lambda run: modsim3d.learn_detector(run=run, interval_s=-1.0),
    "learn_voyage": lambda run: modsim3d.learn_voyage("simulation_1", run, fixed="nothing"),
    "report": lambda run: modsim3d.report(run, tracks=run, other=run),
    "report every": lambda run: modsim3d.report(run, every=0),
    "view_film": lambda run: modsim3d.view_film(run, "x.avi"),
    "view_film look": lambda run: modsim3d.view_film(run, look="foggy"),
    "view_frame": lambda run: modsim3d.view_frame(run, 0, kind="ids", tracks=run),
    "view_frame crop": lambda run: modsim3d.view_frame(run, 0, crop="ships"),
    "view_map": lambda run: modsim3d.view_map(run, width=1),
    "export": lambda run: modsim3d.export(run, run.parent / "x", format="mot", masks=True),
    "export_rerun": lambda run: modsim3d.export_rerun(run, run.parent / "x", every=0),
    "ais": lambda run: modsim3d.ais(run / "run.json", run.parent / "x", end="tomorrow", origin=(100.0, 0.0)),
    "plan_campaign": lambda run: modsim3d.plan_campaign("example", expect={"hotta": (0.6, 0.05)}),
    "run_campaign": lambda run: modsim3d.run_campaign("example", run.parent / "x", shard=(3, 2)),
    "open_campaign": modsim3d.open_campaign,
    "search_campaign": lambda run: modsim3d.search_campaign("example", run.parent / "x"),
    "report_campaign": modsim3d.report_campaign,
    "reproduce_run": lambda run: modsim3d.reproduce_run(run, 0, run.parent / "x"),
    "check_scene": lambda run: modsim3d.check_scene("simulation_1", run / "run.json", overwrite=True),
    "check_repeat": lambda run: modsim3d.check_repeat(run.parent / "x"),
    "check_truth": lambda run: modsim3d.check_truth(modsim3d.load_scene("simulation_1", source="analytic")),
    "view_sheet": lambda run: [modsim3d.view_sheet(run) for _ in range(2)],
    "verify_run": lambda run: modsim3d.verify_run(run, run / "run.json"),
    "load_detector": lambda run: modsim3d.load_detector("thesiss"),
    "guess_detector": lambda run: modsim3d.guess_detector(
        "thesis", run / "run.json", from_condition="day", to_condition="fogg"
    ),
    "learn_from_figures": lambda run: modsim3d.learn_from_figures({"labels": ["boat"], "precision": 2}),
    "LearnResult.write": lambda run: modsim3d.learn_detector(run=run, replicates=20, check=False).write(FILE),
    "ReportedDetector.write": lambda run: modsim3d.learn_from_figures(REPORT).write(FILE),
    "VerifiedRun.write": lambda run: modsim3d.verify_run(run).write(FILE),
}
FILE = Path(__file__)
REPORT = {"labels": ["boat"], "precision": 0.9, "recall": 0.8}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "first"
    modsim3d.run_scene(modsim3d.load_scene("simulation_1", steps=2, source="analytic"), folder)
    return folder


def test_every_function_that_reads_or_writes_is_called_wrongly() -> None:
    functions = {name for name in modsim3d.__all__ if name[0].islower()} - ELSEWHERE
    assert functions - {name.split()[0] for name in WRONG} == {"camera_placement", "locate"}  # which take numbers


@pytest.mark.parametrize("name", WRONG)
def test_errors_name_arguments(name: str, run: Path) -> None:
    with pytest.raises(modsim3d.ModsimError) as raised:
        WRONG[name](run)
    assert "--" not in str(raised.value)
    assert "--" not in "".join(getattr(raised.value, "problems", ()))


@pytest.mark.parametrize(("text", "said"), [
    ("use --overwrite", "use overwrite=True"),
    ("--frame-rate HZ", "frame_rate_hz=HZ"),
    ("give --match optimal", 'give match="optimal"'),
    ("--gospa C:P: must", "gospa_p: must"),
    ("maps, as in --confidence-scale -1.9,3.25", "maps, as in confidence_scale=(-1.9, 3.25)"),
    ("with --camera a; or give --camera a --camera b", 'with cameras "a"; or give cameras "a", "b"'),
    ("command line:\n  --end: needs", "arguments:\n  end_s: needs"),
    ("--set waves.level: no", 'settings["waves.level"]: no'),
    ("go on with modsim3d run --resume", "go on with modsim3d.run_scene(…, resume=True)"),
    ("to see it:\n  modsim3d run x --out y", "to see it:\n  modsim3d run x --out y"),  # to be typed
])  # fmt: skip
def test_options_become_arguments(text: str, said: str) -> None:
    assert with_arguments(text) == said
