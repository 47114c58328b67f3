from __future__ import annotations

import pytest

from modsim3d.core.errors import InputError
from modsim3d.io.strict_text import parse_yaml


def test_a_text_that_is_read_again_gives_a_value_of_its_own() -> None:
    first = parse_yaml("a: [1, {b: 2.5}]\nc: &x [true]\nd: *x\n", "one")
    first["a"][1]["b"] = first["c"] = "changed"
    assert parse_yaml("a: [1, {b: 2.5}]\nc: &x [true]\nd: *x\n", "other") == {
        "a": [1, {"b": 2.5}],
        "c": [True],
        "d": [True],
    }


def test_a_faulty_text_is_refused_each_time_under_its_own_name() -> None:
    for source in ("one", "other"):
        with pytest.raises(InputError, match=f"^{source}:\n  line 1, column 8"):
            parse_yaml("a: 1, b: 2", source)
