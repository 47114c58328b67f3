"""The command line in this process."""

from tests.cli.conftest import modsim3d

__all__ = ["modsim3d"]
