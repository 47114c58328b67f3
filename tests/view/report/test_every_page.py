"""Every page that commands write: what it rests on, what axe-core finds, a narrow screen, and paper."""

import contextlib
import hashlib
import html
import io
import json
import os
import re
from dataclasses import replace
from pathlib import Path

import pytest

from modsim3d import InputError, RunRows, load_scene, open_run, run_scene
from modsim3d.learn.learned_detector import LearnSettings
from modsim3d.learn.report_page import Sources
from modsim3d.view.pages.provenance import CHANGED, Provenance, file_input, run_inputs, top_line
from tests.campaign.campaigns import run_campaign_file
from tests.command_line import call
from tests.view.conftest import perfect, write_csv
from tests.view.report.browser import grave_violations
from tests.view.report.test_layout import DESK, PHONE, pale_texts

CAMPAIGN = {"scene": "fairway", "steps": 4, "seed": 7, "seeds": {"traffic": 2}, "trackers": ["reference"]}
LIMITS = [{"score": "hota", "at_least": 0.0}, {"score": "hota", "at_least": 0.9}]
COMMANDS = {
    "verify": "check run run --out verify",
    "compare": "check truth harbour --steps 2 --out compare",
    "learn": "learn run --replicates 20 --out learn/detector.yaml",
    "score": "score run tracks.csv --threshold 0.4 --out score",
    "report": "report run --out run.html",
    "campaign": "campaign report campaign --out campaign.html",
}
PAGES = {name: f"{name}/{name}.html" for name in ("verify", "compare", "score")}
PAGES |= {"learn": "learn/detector.html", "report": "run.html", "campaign": "campaign.html"}


def command(words: str) -> int:
    with pytest.MonkeyPatch.context() as patch:
        return call(patch, *words.split(), "--quiet")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A folder with every page, which is the working directory, so that paths are given as users do.
    Two cameras and two performance states, as in longer runs: pages have the same parts."""
    folder, before = tmp_path_factory.mktemp("pages"), Path.cwd()
    run_scene(load_scene("simulation_3", mode=2, seed=8, steps=80, source="analytic"), folder / "run")
    (folder / "learn").mkdir()
    rows = RunRows.of(open_run(folder / "run"))
    write_csv(perfect(rows), rows, folder / "tracks.csv")
    run_campaign_file(folder, **CAMPAIGN, set={"annotation.source": "analytic"}, require=LIMITS)
    os.chdir(folder)
    try:
        for words in COMMANDS.values():
            assert command(words) in (0, 1), words
        yield folder
    finally:
        os.chdir(before)


@pytest.fixture(scope="module")
def printed(pages: Path) -> dict[str, str]:
    """What commands print."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as said:
        for words in OUTPUT:
            call(patch, *words.split())
    return {"the terminal": said.getvalue()}


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def block(folder: Path, name: str) -> str:
    """What a page says that it rests on, as its HTML."""
    text = (folder / PAGES[name]).read_text(encoding="utf-8")
    found = re.search(r'<section class="rests-on".*?</section>', text, re.S)
    assert found is not None
    return found[0].replace("<wbr>", "")


def inputs(folder: Path, name: str) -> list[list[str]]:
    """What, path and checksum of each input of a page."""
    rows = re.findall(r"<tr><td>(.*?)</td><td[^>]*>(.*?)</td><td[^>]*>(.*?)</td></tr>", block(folder, name))
    return [[html.unescape(cell.partition("<br>")[0]) for cell in row] for row in rows]


@pytest.mark.parametrize("name", PAGES)
def test_a_page_names_its_command_and_inputs_with_checksums_and_nothing_of_the_machine(pages: Path, name: str) -> None:
    text, found = block(pages, name), inputs(pages, name)
    (said,) = re.findall(r"<th>Made by</th><td><code>(.*?)</code>", text)
    assert html.unescape(said) == f"modsim3d {COMMANDS[name].partition(' --out')[0]}"
    files = [(path, digest) for what, path, digest in found if Path(path).is_file() and what != "scene of the run"]
    assert all(sha256(Path(path)) == digest for path, digest in files) and len(files) >= (0 if name == "compare" else 2)
    assert all(re.fullmatch("[0-9a-f]{64}", digest) for _, _, digest in found) and len(found) > 2
    assert str(pages) not in text and not re.search(r"\d\d:\d\d", text)
    paths = {path for _, path, _ in found}
    assert not any(path.startswith("/") for path in paths)
    if name in ("verify", "learn", "score", "report"):
        assert {f"run/{table}.parquet" for table in ("frames", "truth", "detections")} < paths


def test_a_file_changed_later_stands_out_and_one_given_twice_is_listed_twice(run_folder, tmp_path):
    run = open_run(run_folder)
    assert not any(each.bad for each in run_inputs(run))
    files = {**run.settings["files"], "truth.parquet": {"bytes": 1, "sha256": "0" * 64}}
    (changed,) = (each for each in run_inputs(replace(run, settings={**run.settings, "files": files})) if each.bad)
    assert changed.what == "truth of the run" and changed.note == CHANGED
    assert CHANGED in top_line(Provenance("report of a run", "modsim3d report run", (changed,)))
    assert CHANGED not in top_line(Provenance("report of a run", "modsim3d report run", run_inputs(run)))
    read = [tmp_path / name for name in ("gt/labels/1.txt", "gt/data.yaml", "gt/day/1.txt", "night/1.txt")]
    for path in read:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(path.name)
    truth, detections = (tmp_path / "gt/labels",) * 2, (tmp_path / "gt/day", tmp_path / "night")
    found = Sources(truth, detections, (), tuple(read), LearnSettings(), "learn").inputs
    given = [("ground truth 1", truth[0]), ("detections 1", detections[0])]
    given += [("ground truth 2", truth[0]), ("detections 2", detections[1])]
    listed = [(what, str(path), "of the sha256sum lines of 1 file") for what, path in given]
    said = [(each.what, each.path, each.note.partition(", ")[0]) for each in found]
    assert said == [*listed, ("also read", str(read[1]), "")]
    with pytest.raises(InputError, match=r"gone\.yaml:\n  cannot be read for its checksum: No such file"):
        file_input("detector file", tmp_path / "gone.yaml")


def test_pages_have_what_the_run_has_are_the_same_bytes_again_and_fold_tests_that_pass(pages):
    run = json.loads((pages / "run" / "run.json").read_text())
    for name in ("verify", "score", "report"):
        text = block(pages, name)
        assert run["scene_sha256"] in text and run["backend"] in text
        assert f"<th>Seed: scene</th><td>{run['seed']}</td>" in text and "NumPy" in text
    text = block(pages, "campaign")
    assert re.findall(r"<th>Seed: (.*?)</th><td>(.*?)</td>", text) == [("campaign", "7")]
    assert "<th>Traffic seeds</th><td>2</td>" in text
    what, path, digest = inputs(pages, "learn")[0]
    assert (what, path) == ("detector file that was learned", "detector.yaml")
    assert digest == sha256(pages / "learn" / path)
    for name in ("verify", "compare"):
        command(COMMANDS[name].replace(f"--out {name}", "--out again"))
        assert (pages / "again" / f"{name}.html").read_bytes() == (pages / PAGES[name]).read_bytes()
    verified = json.loads((pages / "verify" / "verify.json").read_text())
    passed = [each for each in verified["parameters"] if each["verdict"] == "obeys"]
    summaries = re.findall(r"<details><summary>[^<]*?: (\d+) tests? passed", (pages / PAGES["verify"]).read_text())
    assert sum(map(int, summaries)) == len(passed) > 20


WRONG = {  # one way to write: what no text for people has
    "a percent sign without a space before it": r"\d%",
    "thousands without a comma": r"^\d{4,}$|(?<![\w.,−-])[1-9]\d{3,} (?:m|px|s|of|wrong|true|false|[a-z-]+s)\b",
    "the key of a score": r"(?<![\w.])(?:hota|deta|assa|mota|idf1|id_switches)\b",
    "another word for false positive": r"[Ff]alse.alarm",
    "a hyphen for a minus sign": r"(?:^|to |± )-\d",
}
KEYED = (
    r"(?s)By their keys<.*?</table>|All settings of the run<.*?</table>|<(code|script|style)\b.*?</\1>|seeds? \d[\d, ]*"
)
OUTPUT = ("campaign table campaign", "campaign status campaign", "check run run", "learn run --out again.yaml")


def test_numbers_and_scores_are_written_in_one_way_on_pages_and_in_terminals(pages, printed):
    texts = {name: re.sub(KEYED, "", (pages / path).read_text(encoding="utf-8")) for name, path in PAGES.items()}
    texts = {name: re.sub(r"<(?!/?(?:b|wbr|span)\b)[^>]*>", "\n", text) for name, text in texts.items()}
    for what, wrong in WRONG.items():
        for name, text in (texts | printed).items():
            found = re.findall(f"^(.*(?:{wrong}).*)$", html.unescape(text), re.M)
            assert not found, (name, what)
    _, _, compared = texts["learn"].rpartition("Where it was not learned")
    decimals = re.findall(r"^\d+(?:\.(\d+))? *$", compared.partition("Spread is")[0], re.M)
    assert len(decimals) >= 4 and {*map(len, decimals)} == {4}  # in columns of real and of simulated numbers


WIDEST = """(() => { document.querySelectorAll('details').forEach(each => each.open = true);
    return document.documentElement.scrollWidth; })()"""


@pytest.mark.parametrize("name", PAGES)
def test_axe_finds_nothing_serious_on_a_page_that_fits_a_phone_and_a_tablet(pages, browser, name):
    browser.visit(pages / PAGES[name], DESK)
    height, links = browser.run(CONTENTS)
    assert bool(links) == all(links) and (links or height < 3 * DESK[1])
    browser.resize(PHONE)
    if name != "report":  # whose player has tests of its own
        assert grave_violations(browser) == []
        browser.scheme("dark")
        assert pale_texts(browser) == []
    for width in (390, 800):
        browser.resize((width, 800))
        assert browser.run(WIDEST) <= width, width
        if name == "score":  # equal shares are equal bars in all columns, beside their names
            assert len(set(browser.run(BARS))) == 1


CONTENTS = """[document.documentElement.scrollHeight, [...document.querySelectorAll('.contents a')].map((each) =>
    document.querySelector(`h2${each.hash}`)?.textContent === each.textContent)]"""
BARS = """[...document.querySelectorAll('.bar')].map((each) => {
    const { left, width } = each.getBoundingClientRect();
    return left >= each.parentElement.getBoundingClientRect().left && width; })"""
PRINTED = """(() => { const rules = [...document.styleSheets].flatMap(sheet => [...sheet.cssRules]);
    const sheet = rules.find(rule => rule instanceof CSSPageRule).cssText;
    const shown = element => element.checkVisibility({contentVisibilityAuto: true, visibilityProperty: true});
    return {sheet, scheme: getComputedStyle(document.documentElement).colorScheme,
        tables: [...document.querySelectorAll('table')].filter(table => !table.closest('.player')).every(shown),
        folded: document.querySelectorAll('details:not([open]) table').length,
        signature: shown(document.querySelector('.signature'))}; })()"""


def test_a_printed_page_has_page_numbers_all_tables_and_a_line_to_sign(pages, browser):
    folded = 0
    for path in PAGES.values():
        browser.visit(pages / path, (680, 800))
        assert not browser.run("document.querySelector('.signature').checkVisibility()")
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        browser.call("Emulation.setEmulatedMedia", media="print", features=dark)
        found = browser.run(PRINTED)
        browser.call("Emulation.setEmulatedMedia", media="", features=[])
        assert "counter(page)" in found["sheet"] and "counter(pages)" in found["sheet"], path
        assert found["scheme"] == "light" and found["tables"] and found["signature"], path
        folded += found["folded"]
    assert folded > 5
