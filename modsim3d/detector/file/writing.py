"""A detector file as text, with matrices in rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml


def detector_text(content: Mapping[str, Any], comments: Sequence[str] = ()) -> str:
    """The YAML of a detector file, after lines of comments."""
    head = "".join(f"# {line}".rstrip() + "\n" for line in comments)
    text: str = yaml.safe_dump(dict(content), sort_keys=False, default_flow_style=None, width=118, allow_unicode=True)
    return head + text
