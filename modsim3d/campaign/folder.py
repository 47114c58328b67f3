"""The folder of a campaign: its file, its plan, the rows that are done, and the results."""

from __future__ import annotations

import errno
import hashlib
import re
import shlex
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.work.checking import CheckedCampaign
from modsim3d.campaign.work.scenes import differing_files, plan_digest
from modsim3d.campaign.work.task import DONE_FOLDER, PLAN, ROWS_PATTERN, Work
from modsim3d.campaign.workers import Death
from modsim3d.core.errors import ModsimError, OutputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import counted, listed
from modsim3d.io.atomic_write import json_text, make_folder, sync_file, sync_folder
from modsim3d.io.overwrite_guard import locked_folder
from modsim3d.io.plugins import differing
from modsim3d.io.validation import join_path, shown
from modsim3d.runs.files.overwrite import FileList, ListedFile, file_list, listed_file

FORMAT = 1
FILE, LOG, VERDICTS = "campaign.yaml", "campaign.log", "verdicts.json"
TOOK, TOOK_VERDICTS = "took.parquet", "took_verdicts.json"
"""What runs took, and the verdicts on it: they do not repeat, so no checksum and no comparison has them."""
RESULTS, SEARCH = "results", "search"  # in the folder of a campaign that has ended: its rows; the trials of a search
LIST = "_files.json"  # in one of these; readers of data sets pass over names that begin so
_ROWS = "**/*.parquet"


@contextmanager
def results_folder(folder: Path, final: str, later: Mapping[str, bytes]) -> Iterator[Path]:
    """A folder to write rows into, which gets its final name, `RESULTS` or `SEARCH`, with the list of all files when it
    is whole. `later` is the content of files of the campaign's folder that are written afterwards, by name. On a file
    system without locks another process may do the same; whoever comes second leaves the first one's. Raises
    OutputError if it cannot be written."""
    partial = folder / f".{final}.{uuid.uuid4().hex}"
    try:
        make_folder(partial)
        yield partial
        files = file_list(folder, (FILE, PLAN))
        files |= {f"{final}/{path.relative_to(partial).as_posix()}": listed_file(path) for path in partial.glob(_ROWS)}
        for name, content in later.items():
            files[name] = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        (partial / LIST).write_bytes(orjson.dumps({"files": dict(sorted(files.items()))}, option=orjson.OPT_INDENT_2))
        sync_file(partial / LIST)
        sync_folder(partial)
        partial.rename(folder / final)
        sync_folder(folder)
    except OSError as error:
        if not (folder / final).is_dir():
            raise OutputError(f"{folder / final} cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def remove_done(folder: CampaignFolder) -> None:
    """Remove the files of tasks of a campaign that has ended, and results that were half written. The folder of tasks
    gets another name first: a worker that still writes a row cannot bring it back."""
    for final in (RESULTS, SEARCH):
        for partial in folder.path.glob(f".{final}.*"):
            shutil.rmtree(partial, ignore_errors=True)
    leaving = folder.path / f".{folder.done.name}.removed"
    shutil.rmtree(leaving, ignore_errors=True)
    with suppress(OSError):  # it is not there
        folder.done.rename(leaving)
    shutil.rmtree(leaving, ignore_errors=True)


def check_ended(folder: Path, later: tuple[str, ...] = ()) -> None:
    """Check that the files of a campaign that has ended are those that it has written; those of `later` may be missing.
    Raises ModsimError if one was changed, is missing or was added, or there is no list."""
    for rows in filter(Path.is_dir, (folder / RESULTS, folder / SEARCH)):
        path = rows / LIST
        try:
            read = orjson.loads(path.read_bytes())["files"].items()
            files: FileList = {name: {"bytes": entry["bytes"], "sha256": entry["sha256"]} for name, entry in read}
            names = sorted({*files, *(file.relative_to(folder).as_posix() for file in rows.glob(_ROWS))})
            disk_files = file_list(folder, (name for name in names if (folder / name).is_file()))
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
            raise ModsimError(
                f"{path} cannot be read, or a file that it lists: {error}; remove {rows}, and the same command makes "
                "it again"
            ) from None
        for name in names:
            if disk_files.get(name) != files.get(name) and (name in disk_files or name not in later):
                change = f"it {_file_state(disk_files.get(name))}, and in {path} it {_file_state(files.get(name))}"
                raise ModsimError(f"{folder / name} was changed after the campaign ended: {change}")


def _file_state(file: ListedFile | None) -> str:
    return "is missing" if file is None else f"has {file['bytes']} bytes and the checksum {file['sha256']}"


MAX_KEYS = 5
PARTS = ("campaign", "versions")  # of a plan, what its user knows: the keys of the file, and the versions of packages


def differences(record: Any, now: Mapping[str, Any]) -> list[str]:
    """The first few keys whose values differ between the content of a stored plan and another, each with both."""
    record = record if isinstance(record, dict) else {}
    changes = [line for part in PARTS for line in _between(record.get(part), now.get(part), (part,))]
    lines = [line.removeprefix("campaign.") for line in changes[:MAX_KEYS]]
    if len(changes) > MAX_KEYS:
        lines.append(f"{len(changes) - MAX_KEYS} more keys")
    return lines or ["a scene, a detector or a tracker that it names was changed"]


def _between(record: Any, now: Any, path: tuple[int | str, ...]) -> Iterator[str]:
    if isinstance(record, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*record, *now]):
            yield from _between(record.get(key), now.get(key), (*path, key))
    elif isinstance(record, list) and isinstance(now, list) and len(record) == len(now):
        for place, (one, other) in enumerate(zip(record, now, strict=True)):
            yield from _between(one, other, (*path, place))
    elif record != now:
        yield f"{join_path(*path)} is {shown(record)} there and {shown(now)} now"


@dataclass(frozen=True, eq=False)
class CampaignFolder:
    """The folder of a campaign whose plan is written."""

    path: Path
    facts: dict[str, Any]  # content of `plan.json`
    plan: Plan

    @property
    def keys(self) -> CampaignKeys:
        """The campaign file."""
        return self.plan.keys

    @property
    def work(self) -> Work:
        """Settings that all its tasks have in common."""
        facts = self.facts
        made_of = {"files": facts["files"], "plugins": facts.get("plugins", {})}
        return Work(self.keys, facts["base"], str(self.path.resolve()), facts["sha256"], **made_of)

    @property
    def done(self) -> Path:
        """The folder of the rows that are done, until the results are written."""
        return self.path / DONE_FOLDER

    @property
    def results(self) -> Path:
        """The data set."""
        return self.path / RESULTS

    @property
    def finished(self) -> bool:
        """Whether the results, or the trials of a search, are there."""
        return (self.results if self.keys.search is None else self.path / SEARCH).is_dir()

    @property
    def total(self) -> int:
        """Number of runs of the plan, or of trials of the search, at most."""
        return len(self.plan) if self.keys.search is None else self.keys.search.budget

    def reproducing(self, number: int) -> str:
        """The command that makes a run again, in `runs/` in the folder."""
        path, out = shlex.quote(str(self.path)), shlex.quote(str(self.path / "runs" / str(number)))
        return f"modsim3d campaign reproduce {path} {number} --out {out}"


def opened_campaign(folder: StrPath) -> CampaignFolder:
    """Open the folder of a campaign. Raises ModsimError if it is none, its plan is damaged, or a file has changed since
    the campaign ended, and TypeError if it is neither text nor a path."""
    path = as_path(folder, "campaign", "the folder of a campaign")
    facts, keys = _read_plan(path / PLAN)
    check_ended(path)
    return CampaignFolder(path, facts, Plan.of(keys))


def _read_plan(path: Path) -> tuple[dict[str, Any], CampaignKeys]:
    """Content of `plan.json`, and the campaign file in it; ModsimError if it is missing, damaged or changed later."""
    try:
        facts: dict[str, Any] = orjson.loads(path.read_bytes())
        stated, checksum, keys = facts["sha256"], plan_digest(facts), CampaignKeys.model_validate(facts["campaign"])
    except OSError as error:
        raise ModsimError(f"{path.parent} is no folder of a campaign: {PLAN}: {error.strerror or error}") from None
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ModsimError(f"{path} is damaged: {type(error).__name__}: {error}") from None
    if checksum != stated:
        raise ModsimError(
            f"{path} was changed after it was written: what decides the results has the checksum {checksum}, and its "
            f"sha256 is {stated}"
        )
    return facts, keys


def planned(campaign: CheckedCampaign, folder: Path) -> CampaignFolder:
    """Write the plan of a campaign into a folder, or find it there; several processes may do so at once. Raises
    OutputError if the folder holds another plan or other files, or cannot be written."""
    facts = {
        "format": FORMAT,
        "sha256": campaign.sha256,
        "base": str(campaign.file.base),
        "runs": len(campaign.plan),
        **campaign.content,
    }
    content = json_text(facts)
    try:
        _place_plan(folder, content)
        _check_same(folder / PLAN, facts)
        if not (folder / FILE).exists():  # after the plan, so that a folder with a file and no plan is not one of ours
            _place(folder / FILE, campaign.file.path.read_bytes())
        here = CampaignFolder(folder, orjson.loads(content), campaign.plan)
        if not here.finished:
            make_folder(here.done)
    except OSError as error:
        raise OutputError(f"{folder} cannot be written to: {error.strerror or error}") from error
    return here


def _place_plan(folder: Path, content: bytes) -> None:
    """Write the plan if there is none; OutputError if the folder holds other files, OSError if it cannot be written."""
    make_folder(folder)
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    if PLAN in names or (folder / PLAN).exists():
        return
    if names:
        raise OutputError(f"{folder} holds other files ({names[0]}): choose a new folder for the campaign")
    _place(folder / PLAN, content)


def _place(path: Path, content: bytes) -> None:
    """Write a file whole unless another process has done so before; whoever comes second leaves the first one's."""
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        partial.write_bytes(content)
        sync_file(partial)
        try:
            path.hardlink_to(partial)
        except FileExistsError:
            return
        except OSError:  # a file system without links: equal plans have equal bytes
            partial.replace(path)
        sync_folder(path.parent)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def locked_campaign(folder: Path) -> Iterator[None]:
    """Hold the lock of the folder, which is made if it is not there. On a file system without locks it is not held: two
    writers then write the same bytes. Raises OutputError if another process works on it, or it cannot be written."""
    with ExitStack() as lock:
        try:
            lock.enter_context(locked_folder(folder))
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
                raise OutputError(f"{folder} cannot be written to: {error.strerror or error}") from error
        yield


def _check_same(plan: Path, facts: dict[str, Any]) -> None:
    """Refuse a folder with another plan: OutputError says what differs. ModsimError if the plan is damaged."""
    old_facts, _ = _read_plan(plan)
    if old_facts["sha256"] == facts["sha256"]:
        return
    files = differing_files(old_facts["files"], facts["files"])
    before, now = old_facts.get("plugins", {}), facts.get("plugins", {})
    files += [f"{file} of the plug-in {key}" for key in now for file in differing(before.get(key, now[key]), now[key])]
    changed = f"{', '.join(files)} changed" if files else "; ".join(differences(old_facts, facts))
    raise OutputError(f"{plan.parent} holds a campaign with another plan: {changed}. Choose another folder")


_LINE = re.compile(r"killed \S+ how=(.*) host=.* runs=([0-9,]+)")
_MAX_RUNS = 8  # numbers of runs in a sentence


def note_kill(folder: CampaignFolder, death: Death, runs: Sequence[int]) -> None:
    """Write into the log that the worker of a task was killed; at once, since the campaign may be interrupted."""
    under_way = ",".join(map(str, runs if death.run is None else [death.run]))
    line = f"killed {time.strftime('%Y-%m-%dT%H:%M:%S%z')} how={death.how} host={death.host} runs={under_way}\n"
    with (folder.path / LOG).open("a", encoding="utf-8") as log:
        log.write(line)


def killed_sentence(folder: CampaignFolder) -> str | None:
    """A sentence on the workers killed so far: number, signals and runs; None if there were none."""
    path = folder.path / LOG
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    kills = [match.groups() for line in lines if (match := _LINE.fullmatch(line))]
    if not kills:
        return None
    hows = listed([f"{how} {count}×" for how, count in Counter(how for how, _ in kills).items()])
    runs = listed(sorted({run for _, runs in kills for run in runs.split(",")}, key=int), _MAX_RUNS)
    return (
        f"Killed from outside, and their work tried again: {counted(len(kills), 'worker')} ({hows}); runs under way: "
        f"{runs} ({LOG})."
    )


def files_of_campaign(folder: CampaignFolder) -> list[Path]:
    """Its file, its plan, its verdicts, its rows or trials, and the list of all these."""
    patterns = ("*.json", f"{RESULTS}/scene=*/part-*.parquet", f"{SEARCH}/*.parquet", f"*/{LIST}")
    paths = [path for pattern in patterns for path in sorted(folder.path.glob(pattern))]
    return [folder.path / FILE, *paths, *sorted(folder.done.glob(ROWS_PATTERN))]
