"""The command line in this process, and campaigns in it too."""

import pytest

from tests.campaign.one_process import ThisProcess
from tests.cli.conftest import modsim3d

__all__ = ["modsim3d"]


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Campaigns start no processes; these have tests of their own."""
    monkeypatch.setattr("modsim3d.campaign.campaign.engine_of", lambda *_: ThisProcess)
