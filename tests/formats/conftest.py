"""A run that several files of this folder export; no test writes into it."""

import pytest

from modsim3d.runs.stored_run import StoredRun
from tests.formats.exported import exported_run


@pytest.fixture(scope="package")
def analytic_run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return exported_run(tmp_path_factory.mktemp("exported"), source="analytic")
