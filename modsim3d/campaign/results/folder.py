"""The folder of a campaign: its file, its plan, the rows that are done, and the results."""

from __future__ import annotations

import errno
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from modsim3d.campaign.file.keys import CampaignKeys
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.results.differences import differences
from modsim3d.campaign.results.ended import RESULTS, check_ended
from modsim3d.campaign.work.checking import CheckedCampaign
from modsim3d.campaign.work.digests import plan_digest
from modsim3d.campaign.work.files import differing_files
from modsim3d.campaign.work.task import DONE_FOLDER, PLAN, Work
from modsim3d.errors import ModsimError, OutputError
from modsim3d.inputs.plugins import differing
from modsim3d.outputs.locks import locked_folder
from modsim3d.outputs.placing import make_folder, sync_file, sync_folder
from modsim3d.paths import StrPath, as_path

FORMAT = 1
FILE, LOG, VERDICTS = "campaign.yaml", "campaign.log", "verdicts.json"


@dataclass(frozen=True, eq=False)
class CampaignFolder:
    """The folder of a campaign whose plan is written.

    Attributes:
        path: The folder.
        facts: The content of `plan.json`.
        plan: The plan.
    """

    path: Path
    facts: dict[str, Any]
    plan: Plan

    @property
    def keys(self) -> CampaignKeys:
        """The campaign file."""
        return self.plan.keys

    @property
    def work(self) -> Work:
        """What all its tasks have in common."""
        facts = self.facts
        made_of = {"files": facts["files"], "plugins": facts.get("plugins", {})}
        return Work(self.keys, facts["base"], str(self.path.resolve()), facts["sha256"], **made_of)

    @property
    def done(self) -> Path:
        """Where the rows are that are done, until the results are written."""
        return self.path / DONE_FOLDER

    @property
    def results(self) -> Path:
        """The data set."""
        return self.path / RESULTS

    @property
    def finished(self) -> bool:
        """Whether the results are there."""
        return self.results.is_dir()


def opened_campaign(folder: StrPath) -> CampaignFolder:
    """Open the folder of a campaign.

    Raises:
        ModsimError: It is none, its plan is damaged, or a file has changed since the campaign ended.
        TypeError: It is neither text nor a path.
    """
    path = as_path(folder, "campaign", "the folder of a campaign")
    facts, keys = _read_plan(path / PLAN)
    check_ended(path)
    return CampaignFolder(path, facts, Plan.of(keys))


def _read_plan(path: Path) -> tuple[dict[str, Any], CampaignKeys]:
    """The content of `plan.json`, and the campaign file in it.

    Raises:
        ModsimError: It is not there, is damaged, or was changed after it was written.
    """
    try:
        facts: dict[str, Any] = orjson.loads(path.read_bytes())
        stated, found, keys = facts["sha256"], plan_digest(facts), CampaignKeys.model_validate(facts["campaign"])
    except OSError as error:
        raise ModsimError(f"{path.parent} is no folder of a campaign: {PLAN}: {error.strerror or error}") from None
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ModsimError(f"{path} is damaged: {type(error).__name__}: {error}") from None
    if found != stated:
        raise ModsimError(
            f"{path} was changed after it was written: what decides the results has the checksum {found}, and its "
            f"sha256 is {stated}"
        )
    return facts, keys


def planned(campaign: CheckedCampaign, folder: Path) -> CampaignFolder:
    """Write the plan of a campaign into a folder, or find it there; several processes may do so at once.

    Raises:
        OutputError: The folder holds another plan or other files, or cannot be written.
    """
    facts = _facts(campaign)
    content = orjson.dumps(facts, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)
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
    """Write the plan if there is none.

    Raises:
        OutputError: The folder holds other files.
        OSError: It cannot be written.
    """
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
    """Hold the lock of the folder, which is made if it is not there.

    On a file system without locks it is not held: two writers then write the same bytes.

    Raises:
        OutputError: Another process works on it, or it cannot be written.
    """
    with ExitStack() as lock:
        try:
            lock.enter_context(locked_folder(folder))
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
                raise OutputError(f"{folder} cannot be written to: {error.strerror or error}") from error
        yield


def _facts(campaign: CheckedCampaign) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "sha256": campaign.sha256,
        "base": str(campaign.file.base),
        "runs": len(campaign.plan),
        **campaign.content,
    }


def _check_same(plan: Path, facts: dict[str, Any]) -> None:
    """Refuse a folder with another plan, and say what differs.

    Raises:
        OutputError: It has.
        ModsimError: The plan is damaged.
    """
    found, _ = _read_plan(plan)
    if found["sha256"] == facts["sha256"]:
        return
    files = differing_files(found["files"], facts["files"])
    before, now = found.get("plugins", {}), facts.get("plugins", {})
    files += [f"{file} of the plug-in {key}" for key in now for file in differing(before.get(key, now[key]), now[key])]
    changed = f"{', '.join(files)} changed" if files else "; ".join(differences(found, facts))
    raise OutputError(f"{plan.parent} holds a campaign with another plan: {changed}. Choose another folder")
