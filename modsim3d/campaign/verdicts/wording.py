"""Requirements, shares and bounds in words."""

from __future__ import annotations

import math

from modsim3d.campaign.file.keys import Requirement

_DIGITS = 4


def requirement_text(requirement: Requirement, within: str = "") -> str:
    """A requirement in words, such as `hota at least 0.6 in state haze`."""
    side = "at least" if requirement.at_least is not None else "at most"
    text = f"{requirement.what} {side} {requirement.threshold:.10g}"
    if requirement.resting_on is not None:
        text += f" resting on {percent(requirement.resting_on)}"
    text += within
    return text if requirement.share is None else f"{text}, in {percent(requirement.share)} of traffic seeds"


def percent(share: float) -> str:
    """A share as the user wrote it, in percent."""
    return f"{100 * share:.10g} %"


def rounded_down(value: float) -> str:
    """A lower bound with four digits, never above what it is; a share near 1 with four digits of what it lacks."""
    return _rounded(value, math.floor)


def rounded_up(value: float) -> str:
    """An upper bound with four digits, never below what it is."""
    return _rounded(value, math.ceil)


def rounded(value: float) -> str:
    """A number with four digits, as near as they allow."""
    return _rounded(value, round)


def counted(number: int, noun: str) -> str:
    """A number of things: `1 traffic seed`, `1,200 traffic seeds`."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _rounded(value: float, whole: object) -> str:
    assert callable(whole)
    if not math.isfinite(value) or value == 0:
        return f"{value:g}".replace("inf", "∞")
    size = min(abs(value), abs(1 - value) or 1.0) if 0 < value < 1 else abs(value)
    decimals = max(0, _DIGITS - 1 - math.floor(math.log10(size)))
    scale = 10.0**decimals
    near = round(value * scale)
    found = near if math.isclose(near, value * scale, rel_tol=1e-12) else whole(value * scale)
    text = f"{found / scale:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
