"""Fixtures that several tests share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from modsim3d.render.context import open_context
from modsim3d.render.id_pass import IdRenderer


@pytest.fixture(scope="session")
def renderer() -> Iterator[IdRenderer]:
    with open_context() as context:
        yield IdRenderer(context)
