"""Identities that a spreadsheet or a data frame has shortened to numbers, such as 2.19E+08 for all of Denmark."""

from __future__ import annotations

import re

SCIENTIFIC = r"^\s*[0-9]+(?:[.,][0-9]*)?[eE]\+?[0-9]+\s*$"
_SCIENTIFIC = re.compile(SCIENTIFIC)
LOST = "is a number in scientific notation that has lost digits: write identities as text, or as whole numbers"


def has_lost_digits(identity: str) -> bool:
    """Whether an identity is a number in scientific notation with fewer digits than it stands for."""
    if not _SCIENTIFIC.match(identity):
        return False
    digits, _, exponent = identity.lower().partition("e")
    return sum(map(str.isdigit, digits)) <= float(exponent)
