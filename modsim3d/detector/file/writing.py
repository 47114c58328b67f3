"""A detector file as text, with matrices in rows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from modsim3d.core.errors import InputError
from modsim3d.detector.dropout import anchor
from modsim3d.io.strict_text import NUMBERS
from modsim3d.io.validation import nearest, shown


class _Dumper(yaml.SafeDumper):
    """Quotes text that YAML 1.2 reads as a number and 1.1, which PyYAML follows, does not, such as `1e3`."""


for tag, pattern, first in NUMBERS:
    _Dumper.add_implicit_resolver(tag, pattern, first)


def detector_text(content: Mapping[str, Any], comments: Sequence[str] = ()) -> str:
    """The YAML of a detector file, after lines of comments."""
    head = "".join(f"# {line}".rstrip() + "\n" for line in comments)
    text: str = yaml.dump(
        dict(content), Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=118, allow_unicode=True
    )
    return head + text


# ---- The miss rate of a detector file, which is no key of it ----

MISS_RATE = "miss_rate"


def is_miss_rate(parts: tuple[str, ...]) -> bool:
    """Whether keys lead to a miss rate: `detector.miss_rate`, or `detector.states.NAME.miss_rate`."""
    inside = len(parts) == 2 or (len(parts) > 3 and parts[1] == "states")
    return inside and parts[0] == "detector" and parts[-1] == MISS_RATE


def with_miss_rate(content: Mapping[str, Any], rate: object, state: str | None, option: str) -> dict[str, Any]:
    """The content of a detector file in which every label is missed at one rate, from 0 to below 1, in a state or, with
    None, in all. The other rows of the confusion matrix keep their proportions in each column. Where misses follow what
    vessels look like and the file has the log-odds that this added in its learning set, the rate is that of the
    learning set again. Errors of the content are left to its own checks. Raises InputError, which calls the setting
    `option`, if it is no such rate, there is no such state, or a label is never found."""
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 <= rate < 1:
        raise InputError(option, [f"a miss rate is a number from 0 to below 1 (got {shown(rate)})"])
    states = content.get("states")
    if not isinstance(states, Mapping):
        return dict(content)
    if state is not None and state not in states:
        raise InputError(option, [f"the detector has no state '{state}' ({nearest(state, states)})"])
    changed = {
        name: _section(section, content.get("dropout"), float(rate), f"{option}: states.{name}")
        if state in (None, name)
        else section
        for name, section in states.items()
    }
    return {**content, "states": changed}


def _section(section: Any, shared: Any, rate: float, where: str) -> Any:
    try:
        matrix = np.array(section["confusion"], dtype=np.float64)
    except (TypeError, KeyError, ValueError):
        return section
    if matrix.ndim != 2 or len(matrix) < 2:
        return section
    found = matrix[:-1].sum(axis=0)
    if np.any(found <= 0):
        column = int(np.argmax(found <= 0))
        raise InputError(
            where, [f"column {column} of its confusion matrix has nothing but misses, so no miss rate fits"]
        )
    rows = np.vstack([matrix[:-1] * ((1 - rate) / found), np.full(matrix.shape[1], rate)])
    return {**section, "confusion": np.round(rows, 12).tolist()} | _intercept(section.get("dropout"), shared, rate)


def _intercept(own: Any, shared: Any, rate: float) -> dict[str, Any]:
    """Intercept with which the mean rate over the learning set is `rate`; empty without log-odds of that set."""
    key = "learned_log_odds"
    source = next((each for each in (own, shared) if isinstance(each, Mapping) and key in each), None)
    try:
        learned = [np.array(quantiles, dtype=np.float64) for quantiles in source[key]] if source else []
    except (TypeError, ValueError):
        return {}
    if any(quantiles.ndim != 1 or not len(quantiles) for quantiles in learned):
        return {}  # which the check of the file says
    intercept = [round(anchor(rate, quantiles, np.ones(len(quantiles))), 12) for quantiles in learned]
    return {"dropout": {**(own if isinstance(own, Mapping) else {}), "intercept": intercept}} if learned else {}
