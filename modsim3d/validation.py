"""Reading YAML and JSON input strictly, and saying everything that is wrong with it at once."""

from __future__ import annotations

import difflib
import gzip
import json
import re
import reprlib
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, BinaryIO, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from modsim3d.errors import InputError

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
Probability = Annotated[float, Field(strict=True, ge=0, le=1)]
Count = Annotated[int, Field(strict=True, ge=0)]
# Far beyond any scene, and near enough that no square or product of them overflows.
MAX_COORDINATE_M = 1e9
Metres = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Rate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]


GZIP = b"\x1f\x8b"
MAX_TEXT_BYTES = 1 << 30
"""Parsed, text takes about ten times its size; a few megabytes can unpack to any size."""
PIECE_BYTES = 1 << 20


class Strict(BaseModel):
    """A section of an input file: unknown keys are errors, values cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class _Yaml12Loader(yaml.SafeLoader):
    """PyYAML with the numbers and booleans of YAML 1.2, and with repeated keys refused."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """The value of a node; PyYAML's own constructors raise errors without a place, such as KeyError."""
        try:
            return super().construct_object(node, deep)
        except (yaml.YAMLError, RecursionError):
            raise
        except Exception:
            kind = node.tag.rpartition(":")[2]
            problem = f"{shown(node.value)} cannot be read as {kind}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from None


# PyYAML follows YAML 1.1: `1e-6` is a string, `no` is false, `1:30` is 90, and it makes dates of keys.
# Its other resolvers are kept.
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
            continue  # `<<: *base` is no key but brings keys, which flatten_mapping puts in
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


def read_text(path: Path, what: str) -> str:
    """The text of an input file, unpacked if it is gzipped, whatever its name.

    Raises:
        InputError: There is no such file, it is a folder, it cannot be read or unpacked, it is not UTF-8, or more than
            any input can be.
    """
    try:
        with path.open("rb") as file:
            packed = file.peek(2).startswith(GZIP)
            content = _at_most(MAX_TEXT_BYTES + 1, gzip.GzipFile(fileobj=file) if packed else file)
        if len(content) > MAX_TEXT_BYTES:
            unpacked = "unpacks to" if packed else "has"
            raise InputError(f"{what} {path}", [f"{unpacked} more than {MAX_TEXT_BYTES:,} bytes: give a part of it"])
        return content.decode("utf-8")
    except (gzip.BadGzipFile, EOFError, zlib.error):
        problem = "is not a complete gzip file"
    except FileNotFoundError:
        problem = "no such file"
    except IsADirectoryError:
        problem = "this is a folder, a file was expected"
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
    except UnicodeDecodeError as error:
        problem = f"is not UTF-8 text (byte {error.start})"
    except ValueError:
        problem = "this cannot be a file's name"  # it holds a null character
    raise InputError(f"{what} {path}", [problem])


def _at_most(count: int, stream: BinaryIO | gzip.GzipFile) -> bytearray:
    """So many bytes or all there are, piece by piece: a single read would set aside room for the whole count."""
    content = bytearray()
    while len(content) < count and (piece := stream.read(min(PIECE_BYTES, count - len(content)))):
        content += piece
    return content


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
        problem = f"character {chr(error.character)!r} may not stand in YAML"
        raise InputError(f"{what} {path}", [f"line {line}, column {column}: {problem}"]) from None
    except RecursionError:
        raise InputError(f"{what} {path}", ["is nested too deeply"]) from None


def _line_and_column(text: str, position: int) -> tuple[int, int]:
    """Both from one."""
    before = text[:position]
    return before.count("\n") + 1, position - before.rfind("\n")


class _Pairs(list[tuple[str, Any]]):
    """A JSON object with its repeated keys still in it."""


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


def load_json(path: Path, what: str) -> Any:
    """The content of a JSON file; repeated keys, which parsers drop silently, are refused.

    Raises:
        InputError: The file cannot be read or is not valid JSON; the message names line and column.
    """
    text = read_text(path, what).removeprefix("\ufeff")
    if not text.strip():
        raise InputError(f"{what} {path}", ["the file is empty"])
    return parse_json(text, f"{what} {path}")


def parse_json(text: str, source: str, first_line: int = 1, whole: str = "file") -> Any:
    """The value of a JSON text; repeated keys, which parsers drop silently, are refused.

    Args:
        text: The text.
        source: What to call it in an error.
        first_line: Number of its first line.
        whole: What ends where the text ends.

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
    return content


def join_path(*parts: object) -> str:
    """A dotted path such as `cameras.C0.mount`; list places as `[2]`."""
    path = ""
    for part in parts:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else str(part)
    return path


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint that names what was probably meant, or all valid names if there are few."""
    names = [str(candidate) for candidate in known]
    close = difflib.get_close_matches(str(name), names, n=1)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(names[:12])}{', …' if len(names) > 12 else ''}" if names else "none are defined"


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """The keys that the section at a location accepts, for the hint beside an unknown key."""
    current: Any = model
    for part in location:
        if get_origin(current) is dict:
            current = get_args(current)[1]
        elif part in getattr(current, "model_fields", {}):
            current = current.model_fields[part].annotation
        else:
            return []
        options = [option for option in get_args(current) if hasattr(option, "model_fields")]
        if get_origin(current) is not dict and len(options) == 1:
            (current,) = options  # `MountKeys | None`
    return list(getattr(current, "model_fields", ()))


_IN_OUR_WORDS = {
    "dict_type": "a mapping of keys is needed",
    "model_type": "a mapping of keys is needed",
    "invalid_key": "a key must be text",
    "list_type": "a list is needed",
    "tuple_type": "a list is needed",
    "too_long": "a list of {max_length} is needed",
    "finite_number": "a finite number is needed",
}
"""What pydantic says in the words of Python, said for the reader of a YAML file."""

_brief = reprlib.Repr()
_brief.maxstring = _brief.maxother = _brief.maxlong = 60
_brief.maxlevel, _brief.maxlist, _brief.maxdict = 3, 4, 4


def shown(value: object) -> str:
    """A value for a message, short however large it is: YAML's aliases can make a few lines enormous."""
    return _brief.repr(value)


def describe(error: ValidationError, model: type[BaseModel], *prefix: object) -> list[str]:
    """One line for each problem that pydantic found: path, what is wrong, the value.

    Args:
        error: What the model's validation raised.
        model: The model, for the names of its keys.
        *prefix: Where the model stands in the file.

    Returns:
        Lines such as `cameras.C0.skew: Input should be a valid number (got 'x')`.
    """
    lines = []
    for item in error.errors(include_url=False):
        location = item["loc"]
        path = join_path(*prefix, *location)
        if location and location[-1] == "[key]":
            path = join_path(*prefix, *map(str, location[:-1]))
            lines.append(f"{path}: a name must be text: put it in quotes")
        elif item["type"] == "extra_forbidden":
            hint = nearest(str(location[-1]), _keys_at(model, location[:-1]))
            lines.append(f"{path}: unknown key" + (f" ({hint})" if hint != "none are defined" else ""))
        elif item["type"] == "missing":
            lines.append(f"{path}: missing")
        elif item["type"] in ("value_error", "assertion_error"):
            lines.append(f"{path}: {item['msg'].removeprefix('Value error, ')}")
        else:
            ours = _IN_OUR_WORDS.get(item["type"])
            message = ours.format(**item.get("ctx", {})) if ours else item["msg"]
            lines.append(f"{path}: {message} (got {shown(item['input'])})")
    return lines
