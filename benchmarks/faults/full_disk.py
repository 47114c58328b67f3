"""File systems that are full or read-only, and limits on the size of files."""

from __future__ import annotations

import os
import random
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from benchmarks.faults.commands import run
from benchmarks.faults.jobs import Job, Outcome, Tried, after

PAGE = 4096
NO_MOUNT = "only root can mount a small file system: the full and the read-only disk were not tried"


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Callable[[str], object]]:
    """A file system of some bytes in a folder; what is given mounts it anew with other options."""

    def mount(options: str) -> object:
        return subprocess.run(["mount", "-o", options, "-t", "tmpfs", "tmpfs", folder], check=True)

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    mount(f"size={size}")
    try:
        yield lambda options: mount(f"remount,{options}")
    finally:
        subprocess.run(["umount", folder], check=True)


def may_mount() -> bool:
    return os.geteuid() == 0 and shutil.which("mount") is not None


def full_disks(job: Job, needed: int, times: int) -> Iterator[Tried]:
    """The disk is full after a share of what the command needs; then it becomes larger.

    Args:
        job: A command whose folder lies in one that can be mounted on.
        needed: Bytes that are there in the middle of the command.
        times: How many sizes are tried.
    """
    disk = job.folder.parent
    for k in range(times):
        size = max(PAGE, int(needed * (k + 0.5) / times)) // PAGE * PAGE
        with small_disk(disk, 64 << 20) as remount:
            job.reset()
            used = shutil.disk_usage(disk).used
            remount(f"size={used + size}")
            ended = run(job.arguments)
            remount(f"size={64 << 20}")
            yield after(job, "the disk is full", f"{job.name}: {size} bytes are free", ended)


def read_only(job: Job) -> Iterator[Tried]:
    """The disk may only be read."""
    with small_disk(job.folder.parent, 64 << 20) as remount:
        job.reset()
        remount("ro")
        ended = run(job.arguments)
        remount("rw")
        tried = after(job, "read-only disk", job.name, ended)
        if tried.outcome in (Outcome.SAME_BYTES, Outcome.OLD_WHOLE):
            tried = replace(tried, outcome=Outcome.REFUSED)
        yield tried


def limited_files(job: Job, largest: int, times: int, seed: int) -> Iterator[Tried]:
    """No file may grow beyond a random size (RLIMIT_FSIZE)."""
    chance = random.Random(f"{seed} {job.name}")
    for _ in range(times):
        size = chance.randrange(largest)
        job.reset()
        ended = run(job.arguments, first=partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size)))
        yield after(job, "files limited in size", f"{job.name}: {size} bytes", ended)
