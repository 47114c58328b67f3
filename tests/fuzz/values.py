"""Values that no reader expects where they stand, from `odd_values.json`."""

import json
import random
from pathlib import Path
from typing import Any

JSON, YAML = "json", "yaml"


def _spelled_out(value: Any) -> Any:
    """A value of the file; `{"repeat": [text, times, ...]}` stands for a long text."""
    if isinstance(value, dict) and "repeat" in value:
        parts = value["repeat"]
        return "".join(text * times for text, times in zip(parts[::2], parts[1::2], strict=True))
    return value


_FILE = json.loads((Path(__file__).parent / "odd_values.json").read_text(encoding="utf-8"))
_TABLE = {name: tuple(map(_spelled_out, values)) for name, values in _FILE.items()}
INTEGERS, FLOATS, TEXTS, OTHERS = (_TABLE[name] for name in ("integers", "floats", "texts", "others"))
NUMBERS = INTEGERS + FLOATS
CELLS, MAGIC = (tuple(text.encode("latin-1") for text in _TABLE[name]) for name in ("cells", "magic"))
_LITERALS = {form: _TABLE[form] for form in (JSON, YAML)}


class Literal(str):
    """Text that stands in a file as it is, not quoted."""


def odd_number(rng: random.Random, value: float) -> Any:
    """A number near the one that was there, or far from it."""
    if not abs(value) < 1e290:
        return rng.choice(NUMBERS)
    return rng.choice(
        (
            *(lambda: -value, lambda: value * rng.choice((0.5, 0.999, 1.001, 2)), lambda: value * (1 + 1e-12)),
            *(lambda: 0, lambda: value + rng.choice((-1, 1)), lambda: value * 10.0 ** rng.randint(-12, 12)),
            *(lambda: float(value), lambda: round(value), lambda: str(value), lambda: [value]),
            *(lambda: rng.uniform(-10, 10), lambda: rng.randint(-3, 20), lambda: rng.choice(NUMBERS)),
        )
    )()


def odd_value(rng: random.Random, value: Any, form: str) -> Any:
    """Something in place of a value of a file of that form."""
    chance = rng.random()
    if isinstance(value, int | float) and chance < 0.45:
        return odd_number(rng, value)
    if isinstance(value, str) and chance < 0.2:
        return rng.choice((value + " ", value.upper(), value[:-1], value * 50, [value], value + "\x07", value + "\0"))
    if chance < 0.6:
        return rng.choice(NUMBERS)
    if chance < 0.75:
        return rng.choice(TEXTS)
    if chance < 0.87:
        return rng.choice(OTHERS)
    return Literal(rng.choice(_LITERALS[form]))
