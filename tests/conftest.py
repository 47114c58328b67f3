"""Fixtures that several tests share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings

from modsim3d.render.context import open_context
from modsim3d.render.id_pass import IdRenderer

# A busy machine fails no test, and a run of the tests is the same as the one before.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def renderer() -> Iterator[IdRenderer]:
    with open_context() as context:
        yield IdRenderer(context)
