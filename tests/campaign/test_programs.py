"""Programs as trackers of a campaign: the C++ example and versions of it that leak, die and stall; and in the world."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from scipy.optimize import linear_sum_assignment

import modsim3d
from modsim3d import ModsimError
from modsim3d.campaign.campaign import present_state
from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.report.campaign_page import campaign_page
from modsim3d.campaign.reproduce import reproduce_run
from modsim3d.campaign.running import run_plan
from modsim3d.campaign.verdicts.verdict import judge
from modsim3d.campaign.work.checking import checked
from modsim3d.campaign.work.row import WORLD_SCORES, world_column
from modsim3d.cli.campaign_text import program_warnings
from tests.campaign.campaigns import campaign_file, checked_campaign, interrupt, problems_of, run_campaign_file
from tests.campaign.hand_made_tables import plan_of, table_of_runs
from tests.campaign.one_process import ThisProcess
from tests.run_folders import run_files, wait_for
from tests.scenes import crossing

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "tracker_command.md").read_text(encoding="utf-8")
CPP, PYTHON, _ = (text for _, text in re.findall(r"```(cpp|python|shell)\n(.*?)```", PAGE, flags=re.DOTALL))
LOOP = "while (std::getline(std::cin, line)) {"
VERSIONS = {
    "good": "",
    "leaks": "std::string* kept = new std::string(4 << 20, 'x'); if (kept->back() == 'y') return 1;",
    "dies": "static int frame = 0; if (++frame == 37) "
    '{ std::cerr << "process " << getpid() << " at frame 37" << std::endl; std::abort(); }',
    "stalls": "static int frame = 0; if (++frame == 5) std::getline(std::cin, line);",
}
REQUIRED = [
    {"score": "frame_ms_p99", "at_most": 1000, "where": {"tracker": "good"}},
    {"score": "peak_memory_mb", "at_most": 60, "where": {"tracker": ["good", "leaks"]}},
    {"score": "hota", "at_least": 0.05, "in": 0.5, "where": {"tracker": ["good", "dies"]}},
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the programs and a campaign of 24 runs of them."""
    if shutil.which("g++") is None:
        pytest.skip("there is no compiler of C++")
    made = tmp_path_factory.mktemp("programs")
    mine = (f'if (program_invocation_short_name == std::string("{name}")) {{ {VERSIONS[name]} }}' for name in VERSIONS)
    program = "#include <errno.h>\n#include <unistd.h>\n" + CPP.replace(LOOP, "\n".join([LOOP, *mine]))
    (made / "tracker.cpp").write_text(program, encoding="utf-8")
    line = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "tracker.cpp", "-o", "good"]
    subprocess.run(line, cwd=made, check=True)
    for name in VERSIONS.keys() - {"good"}:
        shutil.copy(made / "good", made / name)
    limits_s = {name: 1.5 if name == "stalls" else 60.0 for name in VERSIONS}
    trackers = [{"name": name, "command": [f"./{name}"], "timeout_s": limit_s} for name, limit_s in limits_s.items()]
    scene = crossing(made, 40).name
    keys = {"scene": scene, "set": {"annotation.source": "analytic"}, "seeds": {"traffic": 6}}
    campaign_file(made, **keys, trackers=trackers, require=REQUIRED)
    return made


def run_here(folder: Path, out: str, progress: Any = lambda progress: None) -> modsim3d.Campaign:
    """The campaign, run or gone on with in this process."""
    run_plan(checked(read_campaign(folder / "campaign.yaml")), folder / out, ThisProcess, progress=progress)
    return modsim3d.open_campaign(folder / out)


def bytes_of(folder: Path) -> dict[str, bytes]:
    """What is compared byte for byte: everything but what runs took, the log and locks."""
    files = run_files(folder, "campaign.log")
    return {name: content for name, content in files.items() if not Path(name).name.startswith("took")}


def test_24_runs_killed_interrupted_and_gone_on_with_end_as_if_nothing_had_been(folder: Path) -> None:
    line = "campaign run campaign.yaml --out stopped --workers 1 -q"
    with subprocess.Popen([sys.executable, "-m", "modsim3d", *line.split()], cwd=folder) as process:
        wait_for(lambda: [*folder.glob("stopped/done/*.rows")])
        process.send_signal(signal.SIGKILL)
    wait_for(lambda: not [each for each in Path("/proc").glob("[0-9]*/exe") if folder in each.resolve().parents])
    with pytest.raises(KeyboardInterrupt):
        run_here(folder, "stopped", interrupt)
    gone_on, whole = run_here(folder, "stopped"), run_here(folder, "whole")
    assert bytes_of(folder / "stopped") == bytes_of(folder / "whole")
    rows = gone_on.table.to_pylist()
    assert len(rows) == 24 and gone_on.table.drop_columns(TOOK).equals(whole.table.drop_columns(TOOK))
    errors = {row["tracker"]: row["error"] for row in rows}
    assert errors["good"] is errors["leaks"] is None
    assert errors["dies"] == "CoprocessError: the tracker 'dies': camera 'C0' at 36 s: SIGABRT ended it"
    said = {row["tracker"]: row["standard_error"] for row in rows}
    assert re.fullmatch("process [0-9]+ at frame 37", said["dies"]) and said["good"] is None
    assert errors["stalls"].endswith("camera 'C0' at 4 s: no answer within 1.5 s")
    memory = {name: max(row["peak_memory_mb"] or 0 for row in rows if row["tracker"] == name) for name in VERSIONS}
    assert memory["leaks"] > 100 > 60 > memory["good"] > 0


TOOK = ["frame_ms_median", "frame_ms_p99", "frame_ms_max", "peak_memory_mb", "repeats", "standard_error"]


def test_verdicts_on_what_runs_took_stand_apart_and_everything_says_what_went_wrong(folder: Path) -> None:
    campaign = run_here(folder, "whole")
    outcomes = {(each.requirement, each.tracker): each.outcome for each in campaign.verdicts}
    of_scores = {(2, "good"): "met", (2, "dies"): "failed"}
    assert outcomes == {(0, "good"): "met", (1, "good"): "met", (1, "leaks"): "failed", **of_scores}
    apart = json.loads((folder / "whole" / "took_verdicts.json").read_text())
    assert {each["requirement"] for each in apart["verdicts"]} == {0, 1} and apart["repeatable"] is False
    stored = json.loads((folder / "whole" / "verdicts.json").read_text())
    assert {each["requirement"] for each in stored["verdicts"]} == {2}
    parts = [pq.read_schema(path).names for path in (folder / "whole" / "results").rglob("*.parquet")]
    assert parts and not any(set(TOOK) & set(names) for names in parts)
    took = pq.read_table(folder / "whole" / "took.parquet").to_pylist()
    assert [row["repeats"] for row in took] == [True, True, None, None, *[None] * 20]
    opened = opened_campaign(folder / "whole")
    page = campaign_page(opened, campaign.table, campaign.verdicts)
    on_page = "not repeatable", "at frame 37", "Run 0 made twice: good gave the same tracks.", "no answer within 1.5 s"
    assert all(said in page for said in on_page)
    assert "Run 2 crashed: whether dies gives the same tracks again is not known." in page
    listed = json.loads((folder / "whole" / "results" / "_files.json").read_text())["files"]
    assert not [name for name in listed if "took" in name]
    (folder / "whole" / "took.parquet").unlink()
    left = {(each.requirement, each.tracker): each.outcome for each in present_state(opened).verdicts}
    assert left[2, "good"] == "met" and left[0, "good"] == "undecided"


def test_a_program_that_was_changed_is_refused_by_its_name_and_its_tracks_are_of_no_use(folder: Path, tmp_path) -> None:
    shutil.copytree(folder, tmp_path / "copy", ignore=shutil.ignore_patterns("stopped", "whole"))
    copy = tmp_path / "copy"
    keys = yaml.safe_load((copy / "campaign.yaml").read_text()) | {"require": [], "seeds": {"traffic": 1}}
    keys["trackers"] = keys["trackers"][:1]
    campaign_file(copy, **keys)
    before = run_here(copy, "out").table
    with (copy / "good").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(ModsimError, match=r"\./good|good changed"):
        run_here(copy, "out")
    after = run_here(copy, "other").table
    assert before["tracks_key"] != after["tracks_key"] and before["detections_key"] == after["detections_key"]


WRITES = """\
import json, sys
print('{"answers":"steps","tracks":"image"}', flush=True)
with open(sys.argv[1], "a") as log:
    for line in iter(sys.stdin.readline, ""):
        log.write(line)
        if "step" in (given := json.loads(line)):
            print(json.dumps({"step": given["step"], "tracks": []}), flush=True)
"""


def test_a_file_that_a_program_writes_is_none_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "trk.py").write_text(WRITES, encoding="utf-8")
    tracker = {"name": "writes", "command": [sys.executable, "trk.py", "log.txt"]}
    keys = {"scene": crossing(tmp_path, 10).name, "set": {"annotation.source": "analytic"}, "seeds": {"traffic": 2}}
    campaign_file(tmp_path, **keys, trackers=[tracker])
    assert set(run_here(tmp_path, "out").table["status"].to_pylist()) == {"done"}
    with pytest.raises(ModsimError, match=r"trackers\[0\].files is \['trk.py'\] there and \['trk.py', 'log.txt'\] now"):
        run_here(tmp_path, "out")
    campaign_file(tmp_path, **keys, trackers=[{**tracker, "files": ["trk.py"]}])
    assert set(run_here(tmp_path, "out").table["status"].to_pylist()) == {"done"}, "gone on with as it was planned"
    trackers = [{"command": ["sh", "-c", "exec ./trk.py"]}, {**tracker, "files": []}, {**tracker, "name": "known"}]
    said = program_warnings(checked_campaign(tmp_path, **keys, trackers=trackers))
    assert [each[:12] for each in said] == ["trackers[0]:", "trackers[1]:"]


SORT = {"tracker": "sort"}
HALF = {"score": "hota", "at_least": 0.5, "in": 0.5}
TOOK_MS, ESTABLISHED = {"score": "frame_ms_p99", "at_most": 1}, {"score": "established", "at_most": 1}
IMU = {"maximise": "rmse_m", "over": {"imu.heading_noise_rad": [0, 0.01]}, "budget": 1}


@pytest.mark.parametrize(("trackers", "more", "said"), [
    ([{**SORT, "command": ["./x"]}], {}, "trackers[0]: give either tracker, a name, or command"),
    ([{"name": "x"}], {}, "trackers[0]: give either tracker, a name, or command"),
    ([{"command": []}], {}, "trackers[0].command: "),
    ([{"command": ["./nobody"]}], {}, "trackers[0]: command: './nobody': there is no such program"),
    ([{**SORT, "timeout_s": 3}], {}, "trackers[0]: timeout_s is for command"),
    ([{"command": ["true"], "timeout_s": 0}], {}, "trackers[0].timeout_s: "),
    ([{**SORT, "files": []}], {}, "trackers[0]: files is for command"),
    ([{"command": ["true"], "files": ["x.py"]}], {}, "trackers[0]: files: 'x.py': no such file in"),
    (["reference"], {"require": [ESTABLISHED], "x": 1}, "x: unknown key"),
    (["reference"], {"require": [{**ESTABLISHED, "score": "established_mm"}]}, "did you mean 'established_m'"),
    (["reference", "world_gnn"], {"require": [HALF]}, "require[0].score: hota is of tracks in the images, and those of "
     "world_gnn are not: name those that it is about, as in where: {tracker: [reference]}"),
    (["reference"], {"search": IMU}, "search: rmse_m is of tracks in the world, and those of reference are not"),
    (["reference"], {"require": [TOOK_MS], "stop": "sequential"},
     "stop: sequential ends when the requirements are decided, and those on what runs took do not repeat"),
])  # fmt: skip
def test_wrong_keys_are_named(tmp_path: Path, trackers: list[Any], more: dict[str, Any], said: str) -> None:
    problems = problems_of(tmp_path, scene="strait", steps=2, trackers=trackers, **more)
    assert any(said in problem for problem in problems), problems


def test_a_plan_without_programs_is_as_it_was(tmp_path: Path) -> None:
    given = checked_campaign(tmp_path, scene="strait", steps=2, trackers=["reference"]).content["campaign"]["trackers"]
    assert given == [{"tracker": "reference", "name": None, "set": {}}]


def test_a_run_whose_tracks_are_elsewhere_is_not_left_out() -> None:
    """A program that answers in the world where a run is hard, and so has no score in the images there."""
    require = [{"score": score, "at_least": 0.01, "in": 0.3} for score in ("hota", "rmse_m")]
    plan = plan_of(8, [*require, {"score": "hota", "at_least": 0.4}])
    easy, hard = {"appearances": 3, "hota": 0.5}, {"vessels": 3, "rmse_m": 9.0, "followed_share": 0.1}
    verdicts = judge(plan, table_of_runs([easy, hard] * 4))
    found = [(each.outcome, each.seeds, each.nothing, each.undefined, each.left_out) for each in verdicts]
    assert found == [("undecided", 8, 4, 0, 0)] * 3
    assert [each.estimate for each in verdicts[:2]] == [0.5, 0.5]


@pytest.fixture(scope="module")
def in_world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of the Python example and one that has random numbers; its folder."""
    made = tmp_path_factory.mktemp("world")
    (made / "mine.py").write_text(PYTHON, encoding="utf-8")
    loose = PYTHON.replace('"position_m": [x, y]', '"position_m": [x + random.random(), y]')
    (made / "loose.py").write_text(loose.replace("import json\n", "import json\nimport random\n"), encoding="utf-8")
    more = {"set": {"lost_s": 3}}
    trackers = [{"name": name, "command": [sys.executable, f"{name}.py"], **more} for name in ("mine", "loose")]
    near = [{"score": "rmse_m", "at_most": 50, "in": 0.1, "resting_on": 0.01}]
    near.append({"score": "established_m", "at_least": 5, "in": 0.1})
    keys = {"scene": "strait", "steps": 60, "set": {"annotation.source": "rectangles"}, "keep": ["tracks"]}
    run_campaign_file(made, **keys, trackers=trackers, require=near)
    return made / "campaign"


def test_a_row_has_all_world_scores_and_they_are_those_of_short_code_over_the_files(in_world: Path, tmp_path) -> None:
    row = modsim3d.open_campaign(in_world).table.to_pylist()[0]
    again = reproduce_run(in_world, 0, tmp_path / "run")
    assert again.same and again.error is None and reproduce_run(in_world, 0, tmp_path / "run").reused
    run = modsim3d.open_run(tmp_path / "run")
    flat = modsim3d.score_world(run, modsim3d.read_world_tracks(again.tracks, run)).flat()
    kept = {world_column(name): value for name, value in flat.items() if not name.endswith(("_low", "_high"))}
    assert set(kept) == set(WORLD_SCORES) and kept == {name: row[name] for name in kept}
    squares, gospa, seen = defaultdict(list), [], Counter()
    tracks = np.genfromtxt(again.tracks / "world_tracks.csv", delimiter=",", names=True, deletechars='"')
    truth = pq.read_table(tmp_path / "run" / "truth.parquet").to_pylist()
    places = run.scene.poses.poses(0, 60).positions_m[..., :2]
    taken = {camera.name: run.scene.frame_steps(camera, 0, 60) for camera in run.scene.cameras}
    own = [run.scene.vessel_names[index] for index in run.scene.own_ships]
    for step, time_s in enumerate(run.scene.times_s(0, 60)):
        last = {name: steps[steps <= step].max(initial=-1) for name, steps in taken.items()}
        here = {each["vessel"] for each in truth if last[each["camera"]] == each["step"] and each["visible_px"] != 0}
        vessels = [run.scene.vessel_names.index(name) for name in sorted(here) if name not in own]
        told = tracks[np.isclose(tracks["time_s"], time_s)]
        away = np.hypot(*(places[step, vessels][:, None] - np.column_stack([told["w1_m"], told["w2_m"]])).T).T
        i, j = linear_sum_assignment(np.minimum(away, 50))
        gospa.append(np.minimum(away, 50)[i, j].sum() + 25 * abs(away.shape[0] - away.shape[1]))
        seen.update(vessels)
        for a, b in zip(i, j, strict=True):
            if away[a, b] <= 50:
                squares[vessels[a]].append(away[a, b] ** 2)
    assert row["gospa_m"] == pytest.approx(np.mean(gospa))
    assert row["rmse_m"] == pytest.approx(np.mean([np.sqrt(np.mean(each)) for each in squares.values()])) and squares
    assert row["followed_share"] == pytest.approx(np.mean([len(squares[each]) / seen[each] for each in seen]))
    assert (row["vessels"], row["world_established"]) == (len(seen), sum(map(bool, squares.values())))


def test_what_does_not_repeat_is_said_and_world_scores_have_verdicts(in_world: Path) -> None:
    campaign = modsim3d.open_campaign(in_world)
    page = campaign_page(opened_campaign(in_world), campaign.table, campaign.verdicts)
    assert "Run 0 made twice: mine gave the same tracks." in page
    assert "Run 1 made twice: loose gave OTHER TRACKS" in page
    assert [each.estimate for each in campaign.verdicts[:2]] == [1.0, 1.0], "rmse_m is right in the only seed"
    assert {row["worst_s"] for row in campaign.table.to_pylist()} == {None}
    shown = campaign.means()[0].means
    assert shown["rmse_m"].value is not None and "hota" not in shown
