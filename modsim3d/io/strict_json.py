"""JSON without repeated keys, which parsers drop silently."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from modsim3d.core.errors import InputError
from modsim3d.io import input_files
from modsim3d.io.input_files import composed, read_text
from modsim3d.io.validation import join_path


class _Pairs(list[tuple[str, Any]]):
    """A JSON object that keeps its repeated keys."""


def _repeated_keys(content: Any, path: tuple[object, ...]) -> list[str]:
    """Paths of the keys that appear more than once in a JSON object."""
    if not isinstance(content, list):
        return []
    pairs = content if isinstance(content, _Pairs) else list(enumerate(content))
    seen: set[object] = set()
    found: list[str] = []
    for key, value in pairs:
        if key in seen:
            found.append(f"{join_path(*path, key)}: the key '{key}' appears twice")
        seen.add(key)
        found += _repeated_keys(value, (*path, key))
    return found


def load_json(path: Path, what: str, bytes_per_value: int | None = None) -> Any:
    """The content of a JSON file; repeated keys are refused.

    Args:
        path: The file.
        what: What it is, for errors.
        bytes_per_value: As in `check_values`.

    Raises:
        InputError: The file cannot be read, exceeds a budget or is not valid JSON; the message names line and column.
    """
    text = read_text(path, what)
    if not text.strip():
        raise InputError(f"{what} {path}", ["the file is empty"])
    check_values(text, f"{what} {path}", bytes_per_value)
    return parse_json(text, f"{what} {path}")


def check_values(text: str, source: str, bytes_per_value: int | None = None) -> None:
    """Refuse a JSON text with more values than the budget, before they fill the memory.

    Args:
        text: JSON. Its commas and opening brackets are counted, those within texts too.
        source: Name of the source, for errors.
        bytes_per_value: A text may have more values than the budget if it is so many bytes long for each of them.

    Raises:
        InputError: There are too many.
    """
    most = max(input_files.MAX_JSON_VALUES, len(text) // bytes_per_value if bytes_per_value else 0)
    count = sum(text.count(mark) for mark in ",[{")
    if count > most:
        problem = f"has {count:,} values (commas and brackets) in {len(text):,} characters; at most {most:,} are read"
        raise InputError(source, [problem])


def parse_json(text: str, source: str, first_line: int = 1, whole: str = "file") -> Any:
    """The value of a JSON text; repeated keys are refused.

    Args:
        text: JSON.
        source: Name of the source, for errors.
        first_line: Number of the text's first line in the source.
        whole: What the text is, for errors: `file` or `line`.

    Raises:
        InputError: It is not valid JSON; the message names line and column.
    """
    repeated = False

    def mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        nonlocal repeated
        result = dict(pairs)
        repeated = repeated or len(result) < len(pairs)
        return result

    try:
        content = json.loads(text, object_pairs_hook=mapping)
        if repeated:
            problems = _repeated_keys(json.loads(text, object_pairs_hook=_Pairs), ())
            raise InputError(source, list(dict.fromkeys(problems)))
    except json.JSONDecodeError as error:
        where = f"line {first_line + error.lineno - 1}, column {error.colno}"
        unfinished = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated")
        cut = f" (the {whole} ends here: is it cut off?)" if unfinished else ""
        raise InputError(source, [f"{where}: {error.msg}{cut}"]) from None
    except RecursionError:
        raise InputError(source, ["is nested too deeply"]) from None
    except ValueError as error:  # an integer of thousands of digits
        raise InputError(source, [f"a value cannot be read: {error}"]) from None
    return composed_values(content, text)


def composed_values(content: Any, text: str) -> Any:
    """The value of a JSON text with accents as `read_text` has them, also where they are escaped."""
    marked = re.search(r"\\u03[0-6]", text)
    return json.loads(composed(json.dumps(content, ensure_ascii=False))) if marked else content
