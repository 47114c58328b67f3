"""docs/waves.md: its examples are valid, and its tables name what there is."""

import re
from pathlib import Path

import pytest
import yaml

from modsim3d.runs.files.table_columns import OWN_SHIP_SCHEMA
from modsim3d.scene.keys import ImuKeys, WavesKeys

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "waves.md").read_text(encoding="utf-8")
KEYS = {"waves": WavesKeys, "imu": ImuKeys}


def named(table: str) -> set[str]:
    """The code words in the first column of the table whose head begins so."""
    rows = PAGE[PAGE.index(table) :].split("\n\n")[0].splitlines()[2:]
    return {name for row in rows for name in re.findall(r"`([a-z0-9_]+)`", row.split("|")[1])}


@pytest.mark.parametrize("text", re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL))
def test_examples_are_valid(text):
    ((key, value),) = yaml.safe_load(text.replace("e-5", "e-05")).items()
    KEYS[key].model_validate(value)


def test_tables_name_every_key_and_every_column_of_own_ship():
    assert named("| Key | Unit | Default | Goes with") == set(WavesKeys.model_fields)
    assert named("| Key | Unit | Default | Meaning") == set(ImuKeys.model_fields)
    between = {"measured_q_rad_s", "measured_f2_m_s2"}  # inside the dots
    assert named("| Column | Unit | Meaning") | between == set(OWN_SHIP_SCHEMA.names)
