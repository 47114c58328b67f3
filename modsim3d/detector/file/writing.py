"""A detector file as text, with matrices in rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from modsim3d.inputs.strict_yaml import NUMBERS


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
