"""Campaigns that tests write and run in this process."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any

import pytest
import yaml

from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.running import CampaignResult, run_plan
from modsim3d.campaign.work.checking import CheckedCampaign, checked
from modsim3d.campaign.work.task import Task, TaskReport
from modsim3d.campaign.workers import LOST, Death, Engine
from modsim3d.core.document import Block, Where, blocks_at
from modsim3d.core.errors import InputError
from modsim3d.view.pages.page import html_of
from tests.campaign.one_process import ThisProcess


def campaign_file(folder: Path, name: str = "campaign.yaml", **keys: Any) -> Path:
    """A campaign file with these keys, which is written into the folder."""
    (folder / name).write_text(yaml.safe_dump(keys), encoding="utf-8")
    return folder / name


def checked_campaign(folder: Path, name: str = "campaign.yaml", **keys: Any) -> CheckedCampaign:
    return checked(read_campaign(campaign_file(folder, name, **keys)))


def problems_of(folder: Path, **keys: Any) -> tuple[str, ...]:
    """The problems of a campaign with these keys, which is refused."""
    with pytest.raises(InputError) as refused:
        checked_campaign(folder, **keys)
    return refused.value.problems


def run_campaign_file(folder: Path, name="campaign.yaml", cache: Path | None = None, **keys: Any) -> CampaignResult:
    """A checked campaign, run into the folder of the file's name."""
    result = run_plan(checked_campaign(folder, name, **keys), folder / Path(name).stem, ThisProcess, cache=cache)
    assert result is not None
    return result


def count_calls(patch: pytest.MonkeyPatch, module: ModuleType, names: Mapping[str, str]) -> Counter[str]:
    """Calls of functions of a module from now on, by what each name stands for."""
    counts: Counter[str] = Counter()

    def call(counted: str, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        counts[counted] += 1
        return function(*arguments, **keywords)

    for name, counted in names.items():
        patch.setattr(module, name, partial(call, counted, getattr(module, name)))
    return counts


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def no_engine(*_: object) -> Engine:
    raise AssertionError("there is nothing to do")


class Shuffled(ThisProcess):
    """Does tasks in another order than they come in, as many workers do."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width, self._chance = width, Random(width)

    def next(self) -> tuple[Task, TaskReport | Death]:
        self._chance.shuffle(self._waiting)
        return super().next()


class Losing(ThisProcess):
    """Loses tasks for which something holds with their worker, of which nothing is known."""

    def __init__(self, lost: Callable[[Task], bool]) -> None:
        super().__init__()
        self._lost = lost

    def next(self) -> tuple[Task, TaskReport | Death]:
        return (self._waiting.pop(0), LOST) if self._lost(self._waiting[0]) else super().next()


def html_of_blocks(blocks: Iterable[Block]) -> str:
    return "\n".join(map(html_of, blocks_at(blocks, Where.PAGE)))
