"""YAML with the types, numbers and booleans of YAML 1.2, and JSON; both without repeated keys, and within a budget."""

import json
import pickle
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from modsim3d.core.errors import InputError
from modsim3d.io import input_files
from modsim3d.io.input_files import composed, read_text
from modsim3d.io.validation import join_path, shown

try:
    from yaml.cyaml import CParser  # type: ignore[attr-defined]
except ImportError:  # PyYAML without its C library, which is ten times as fast
    CParser = None  # type: ignore[assignment, misc]

_CORE = "tag:yaml.org,2002:"
_MERGE = f"{_CORE}merge"
_REPEATED_CHARACTERS = 100_000  # faulty texts up to this length are parsed again by PyYAML's parser, which says more
_TEXTS_KEPT, _KEPT_CHARACTERS = 16, 100_000  # values kept for whoever reads a text again, and the length of such texts


def _refused(problem: str, node: yaml.Node) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(None, None, problem, node.start_mark)


class _Yaml12(Composer, SafeConstructor, Resolver):
    """Nodes and values of YAML 1.2 from the events of a parser; refuses too many nodes, and repeated keys."""

    def __init__(self) -> None:
        Composer.__init__(self)
        SafeConstructor.__init__(self)
        Resolver.__init__(self)
        self.nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """The next node; refused beyond the budget of nodes."""
        node = super().compose_node(parent, index)
        self.nodes += 1
        if node is not None and self.nodes > input_files.MAX_YAML_VALUES:
            raise _refused(_too_many("values"), node)
        return node

    def get_single_node(self) -> yaml.Node | None:
        """The document, once it is known that its aliases do not multiply it beyond the budget."""
        node = super().get_single_node()
        if node is not None and _values(node, {}) > input_files.MAX_YAML_VALUES:
            problem = _too_many("values once its aliases (*) and merge keys (<<) are written out")
            raise yaml.constructor.ConstructorError(None, None, problem, None)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """The value of a node. Some of PyYAML's constructors raise errors without a place, such as KeyError."""
        try:
            return super().construct_object(node, deep)
        except (yaml.YAMLError, RecursionError):
            raise
        except Exception:
            kind = node.tag.rpartition(":")[2]
            raise _refused(f"{shown(node.value)} cannot be read as {kind}", node) from None


def _too_many(what: str) -> str:
    most = f"{input_files.MAX_YAML_VALUES:,}"
    return f"the file has more than {most} {what}; give large tables as JSON, as vessels and poses can be"


def _values(node: yaml.Node, counts: dict[int, int]) -> int:
    """Values of a node with all that its aliases repeat; `counts` has those of nodes by their `id`."""
    if id(node) not in counts:
        counts[id(node)] = 0  # a node within itself, which cannot be constructed
        count = 1
        if isinstance(node, yaml.ScalarNode):
            count += len(node.value) // input_files.YAML_CHARACTERS_PER_VALUE
        elif isinstance(node, yaml.SequenceNode):
            count += sum(_values(item, counts) for item in node.value)
        else:
            count += sum(_values(part, counts) for pair in node.value for part in pair)
        counts[id(node)] = count
    return counts[id(node)]


# PyYAML follows YAML 1.1, where `1e-6` is a string, `no` is false, `1:30` is 90, and some texts are dates or `=`.
# These resolvers are replaced; those of null and of merge keys stay.
_Yaml12.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag.endswith((":null", ":merge"))]
    for first, resolvers in Resolver.yaml_implicit_resolvers.items()
}
_Yaml12.add_implicit_resolver(f"{_CORE}bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF"))
_FINITE = r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
NUMBERS = (  # tag, pattern and first characters of the texts that are numbers
    (f"{_CORE}int", re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789")),
    (f"{_CORE}float", re.compile(rf"^(?:{_FINITE}|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"), list("-+.0123456789")),
)
for _number in NUMBERS:
    _Yaml12.add_implicit_resolver(*_number)


def _construct_int(loader: _Yaml12, node: yaml.ScalarNode) -> int:
    return int(loader.construct_scalar(node), 10)  # YAML 1.1 reads 010 as eight


def _construct_mapping(loader: _Yaml12, node: yaml.MappingNode) -> dict[Any, Any]:
    if not isinstance(node, yaml.MappingNode):
        raise _refused(f"a mapping is expected, but found a {node.id}", node)
    seen: set[Any] = set()
    for key_node, _ in node.value:
        if key_node.tag == _MERGE:
            continue  # `<<: *base` is no key; flatten_mapping inserts its keys
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str | int | float | bool):
            raise _refused("a key must be plain text", key_node)
        if key in seen:
            raise _refused(f"key {shown(key)} appears twice", key_node)
        seen.add(key)
    loader.flatten_mapping(node)
    return loader.construct_mapping(node, deep=True)


def _refuse_tag(loader: _Yaml12, node: yaml.Node) -> None:
    tag = node.tag.replace(_CORE, "!!", 1)
    raise _refused(f"the tag {tag[:60]} is not read: leave it out, and write text, numbers, lists and mappings", node)


# Nothing else: no bytes, dates, sets or ordered mappings, which no section of any file can use.
_Yaml12.yaml_constructors = {
    f"{_CORE}null": SafeConstructor.construct_yaml_null,
    f"{_CORE}bool": SafeConstructor.construct_yaml_bool,
    f"{_CORE}int": _construct_int,
    f"{_CORE}float": SafeConstructor.construct_yaml_float,
    f"{_CORE}str": SafeConstructor.construct_yaml_str,
    _MERGE: SafeConstructor.construct_yaml_str,  # `<<` that is no key
    f"{_CORE}seq": SafeConstructor.construct_yaml_seq,
    f"{_CORE}map": _construct_mapping,
    None: _refuse_tag,
}


class _PythonLoader(_Yaml12, yaml.reader.Reader, yaml.scanner.Scanner, yaml.parser.Parser):
    """The parser of PyYAML."""

    def __init__(self, text: str) -> None:
        yaml.reader.Reader.__init__(self, text)
        yaml.scanner.Scanner.__init__(self)
        yaml.parser.Parser.__init__(self)
        _Yaml12.__init__(self)


_FastLoader: Any = _PythonLoader
if CParser is not None:

    class _FastLoader(_Yaml12, CParser):  # type: ignore[no-redef]
        """The parser of its C library, but not its composer, which a text that is nested too deeply crashes."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            _Yaml12.__init__(self)


def load_yaml(path: Path, what: str) -> Any:
    """The content of a YAML file, with the types, numbers and booleans of YAML 1.2. Raises InputError, with line and
    column, if the file cannot be read, exceeds a budget or is not valid YAML."""
    return parse_yaml(read_text(path, what, input_files.MAX_YAML_BYTES), f"{what} {path}")


def parse_yaml(text: str, source: str) -> Any:
    """The content of a text of YAML, as `load_yaml` has that of a file; messages call the text `source`. Raises
    InputError if the text exceeds a budget or is not valid YAML."""
    try:
        return pickle.loads(_pickled(text)) if len(text) <= _KEPT_CHARACTERS else _parsed(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = ": ".join(part for part in (error.context, error.problem) if part)
        raise InputError(source, [f"{where}{problem}"]) from None
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        line, column = before.count("\n") + 1, error.position - before.rfind("\n")
        problem = f"character {chr(error.character)!r} is not allowed in YAML"
        raise InputError(source, [f"line {line}, column {column}: {problem}"]) from None
    except RecursionError:
        raise InputError(source, ["is nested too deeply"]) from None


@lru_cache(_TEXTS_KEPT)
def _pickled(text: str) -> bytes:
    """The value of a text of YAML as bytes, since callers change values: many runs read the same scene and detector."""
    return pickle.dumps(_parsed(text))


def _parsed(text: str) -> Any:
    try:
        return _FastLoader(text).get_single_data()
    except yaml.YAMLError:
        if len(text) <= _REPEATED_CHARACTERS:
            _PythonLoader(text).get_single_data()  # raises the same error in better words
        raise


class _Pairs(list[tuple[str, Any]]):
    """A JSON object that keeps its repeated keys."""


def _repeated_keys(content: Any, path: tuple[object, ...]) -> list[str]:
    if not isinstance(content, list):
        return []
    pairs = content if isinstance(content, _Pairs) else list(enumerate(content))
    seen: set[object] = set()
    problems: list[str] = []
    for key, value in pairs:
        if key in seen:
            problems.append(f"{join_path(*path, key)}: the key '{key}' appears twice")
        seen.add(key)
        problems += _repeated_keys(value, (*path, key))
    return problems


def load_json(path: Path, what: str, bytes_per_value: int | None = None) -> Any:
    """The content of a JSON file; `bytes_per_value` as in `check_values`. Raises InputError, with line and column, if
    the file cannot be read, exceeds a budget, is not valid JSON or repeats a key."""
    text = read_text(path, what)
    if not text.strip():
        raise InputError(f"{what} {path}", ["the file is empty"])
    check_values(text, f"{what} {path}", bytes_per_value)
    return parse_json(text, f"{what} {path}")


def check_values(text: str, source: str, bytes_per_value: int | None = None) -> None:
    """Refuse a JSON text with more values than the budget, before they fill the memory. Its commas and opening brackets
    are counted, those within texts too. A text of `bytes_per_value` bytes for each value may exceed the budget."""
    most = max(input_files.MAX_JSON_VALUES, len(text) // bytes_per_value if bytes_per_value else 0)
    count = sum(text.count(mark) for mark in ",[{")
    if count > most:
        problem = f"has {count:,} values (commas and brackets) in {len(text):,} characters; at most {most:,} are read"
        raise InputError(source, [problem])


def parse_json(text: str, source: str, first_line: int = 1, whole: str = "file") -> Any:
    """The value of a JSON text, whose first line is the `first_line`-th of the source; `whole` is what errors call the
    text, `file` or `line`. Raises InputError, with line and column, if it is not valid JSON or repeats a key."""
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
