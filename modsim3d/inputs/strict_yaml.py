"""YAML files with the numbers and booleans of YAML 1.2 and without repeated keys."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from modsim3d.errors import InputError
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import shown


class _Yaml12Loader(yaml.SafeLoader):
    """PyYAML with the numbers and booleans of YAML 1.2; it refuses repeated keys."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """The value of a node. Some of PyYAML's constructors raise errors without a place, such as KeyError."""
        try:
            return super().construct_object(node, deep)
        except (yaml.YAMLError, RecursionError):
            raise
        except Exception:
            kind = node.tag.rpartition(":")[2]
            problem = f"{shown(node.value)} cannot be read as {kind}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from None


# PyYAML follows YAML 1.1, where `1e-6` is a string, `no` is false, `1:30` is 90 and some keys are dates.
# These resolvers are replaced; the others stay.
_Yaml12Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith((":bool", ":int", ":float", ":timestamp"))]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Yaml12Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_Yaml12Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789"))
_Yaml12Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+.0123456789"),
)


def _construct_int(loader: _Yaml12Loader, node: yaml.ScalarNode) -> int:
    return int(loader.construct_scalar(node), 10)  # YAML 1.1 reads 010 as eight


def _construct_mapping(loader: _Yaml12Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        if key_node.tag == "tag:yaml.org,2002:merge":
            continue  # `<<: *base` is no key; flatten_mapping inserts its keys
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str | int | float | bool):
            raise yaml.constructor.ConstructorError(None, None, "a key must be plain text", key_node.start_mark)
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"key '{key}' appears twice", key_node.start_mark)
        seen.add(key)
    loader.flatten_mapping(node)
    return loader.construct_mapping(node, deep=True)


_Yaml12Loader.add_constructor("tag:yaml.org,2002:int", _construct_int)
_Yaml12Loader.add_constructor("tag:yaml.org,2002:map", _construct_mapping)


def load_yaml(path: Path, what: str) -> Any:
    """The content of a YAML file, with the numbers and booleans of YAML 1.2.

    Raises:
        InputError: The file cannot be read or is not valid YAML; the message names line and column.
    """
    text = read_text(path, what)
    try:
        return yaml.load(text, Loader=_Yaml12Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = ": ".join(part for part in (error.context, error.problem) if part)
        raise InputError(f"{what} {path}", [f"{where}{problem}"]) from None
    except yaml.reader.ReaderError as error:
        line, column = _line_and_column(text, error.position)
        problem = f"character {chr(error.character)!r} is not allowed in YAML"
        raise InputError(f"{what} {path}", [f"line {line}, column {column}: {problem}"]) from None
    except RecursionError:
        raise InputError(f"{what} {path}", ["is nested too deeply"]) from None


def _line_and_column(text: str, position: int) -> tuple[int, int]:
    """Line and column of a character, counted from one."""
    before = text[:position]
    return before.count("\n") + 1, position - before.rfind("\n")
