"""Learning in tests is compared with real results over fewer seeds than a user's."""

from collections.abc import Iterator

import pytest

from modsim3d.learn import self_check


@pytest.fixture(autouse=True, scope="session")
def few_seeds() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(self_check, "SEEDS", 3)
        yield
