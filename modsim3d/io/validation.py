"""Types and messages that input files share, so that all problems are reported at once and in the same words."""

import difflib
import reprlib
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, Union, cast, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, core_schema

from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath
from modsim3d.io.input_files import data_folder

MIN_NUMBER, MAX_NUMBER = 1e-9, 1e9  # sizes of numbers that are no place and no time, so that products do not overflow


class Limits:
    """Limits of a number in the annotation of a field; text and truth values are no numbers. `Field` has the same
    limits, but a model with many numbers takes twice as long to build with it."""

    def __init__(self, check: Callable[[float], float] | None = None, **limits: float | bool) -> None:
        """Take limits as `Field` has them: `ge`, `gt`, `le` and `lt`, and `allow_inf_nan` for a float. `check` is given
        a number within the limits and returns it, as that of an `AfterValidator`."""
        self._check = check
        self._limits: dict[str, Any] = limits

    def __get_pydantic_core_schema__(self, source: type[float], handler: GetCoreSchemaHandler) -> CoreSchema:
        """Schema that pydantic asks for when it builds a model."""
        schema_of = core_schema.int_schema if source is int else core_schema.float_schema
        schema = schema_of(strict=True, **self._limits)
        return core_schema.no_info_after_validator_function(self._check, schema) if self._check else schema


class NeedText:
    """The one error of a field of several types or many numbers, whatever is wrong inside: what is needed."""

    def __init__(self, words: str) -> None:
        """Take the words."""
        self._words = words

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Schema that pydantic asks for when it builds a model."""
        return core_schema.custom_error_schema(handler(source), "needed", custom_error_message=self._words)


HORIZON = NeedText("a row, or x and y of two points, as in [0, 400, 1920, 410], is needed")


def _not_tiny(value: float) -> float:
    if 0 < value < MIN_NUMBER:
        raise ValueError(f"{value:g} is too small to calculate with: at least {MIN_NUMBER:g}")
    return value


Number = Annotated[float, Limits(allow_inf_nan=False, ge=-MAX_NUMBER, le=MAX_NUMBER)]
Positive = Annotated[float, Limits(_not_tiny, allow_inf_nan=False, gt=0, le=MAX_NUMBER)]
NotNegative = Annotated[float, Limits(_not_tiny, allow_inf_nan=False, ge=0, le=MAX_NUMBER)]
Probability = Annotated[float, Limits(ge=0, le=1)]
Count = Annotated[int, Limits(ge=0)]
MAX_COORDINATE_M = 1e9  # far beyond any scene; squares and products do not overflow
Metres = Annotated[float, Limits(allow_inf_nan=False, ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Rate = Annotated[float, Limits(allow_inf_nan=False, ge=-1e6, le=1e6)]


class Strict(BaseModel):
    """A section of an input file: unknown keys are errors, values cannot be changed.

    Attributes:
        alternatives: Choices, each of groups of keys of which only one may be there. Setting a key that is in one
            group only removes the keys of the other groups.
    """

    alternatives: ClassVar[tuple[tuple[tuple[str, ...], ...], ...]] = ()

    # Most models are never used in a process: each is built when it is, which takes as long as importing NumPy in all.
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


def join_path(*parts: object) -> str:
    """A dotted path such as `cameras.C0.mount`; list places as `[2]`."""
    path = ""
    for part in parts:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else str(part)
    return path


def nearest(name: str, choices: Iterable[str]) -> str:
    """A hint: the known name that was probably meant, or the known names."""
    name, names = str(name), [str(candidate) for candidate in choices]
    likely = names[:MAX_COMPARED] if len(name) <= MAX_COMPARED_LENGTH else []
    by_small = {candidate.lower(): candidate for candidate in reversed(likely)}
    if close := difflib.get_close_matches(name.lower(), by_small, n=1):
        return f"did you mean '{by_small[close[0]]}'?"
    return f"known: {', '.join(names[:12])}{', …' if len(names) > 12 else ''}" if names else "none are defined"


def nearest_key(key: str, choices: Collection[str]) -> str:
    """The hint of `nearest` for a key, or the known keys that others call like this; see `synonyms.yaml`."""
    word, table = str(key).lower().replace("-", "_"), _synonyms().items()
    keys = [f"'{path}'" for path, synonyms in table if word in synonyms and path.partition(".")[0] in choices]
    return f"did you mean {' or '.join(keys)}?" if keys else nearest(key, choices)


@cache
def _synonyms() -> dict[str, list[str]]:
    return cast(dict[str, list[str]], yaml.safe_load(Path(__file__).with_name("synonyms.yaml").read_text("utf-8")))


def model_at(model: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel] | None:
    """The model of the section at a location; None where there is none."""
    current: Any = model
    for part in location:
        if get_origin(current) is dict:
            current = get_args(current)[1]
        elif get_origin(current) in (list, tuple) and isinstance(part, int):
            items = [member for member in get_args(current) if member is not ...]
            current = items[min(part, len(items) - 1)]
        elif part in getattr(current, "model_fields", {}):
            current = current.model_fields[part].annotation
        else:
            return None
        if isinstance(current, UnionType) or get_origin(current) is Union:
            options = [option for option in get_args(current) if hasattr(option, "model_fields") or get_origin(option)]
            current = options[0] if len(options) == 1 else None  # `MountKeys | None`
    return current if hasattr(current, "model_fields") else None


_WORDS = {  # of each type of error, for readers of YAML: pydantic's own messages use the words of Python
    **dict.fromkeys(("dict_type", "model_type"), "a mapping of keys is needed"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list, as [a, b], is needed"),
    **dict.fromkeys(("int_type", "int_parsing", "int_parsing_size", "int_from_float"), "a whole number is needed"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number is needed"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false is needed"),
    "finite_number": "a finite number is needed",
    "greater_than": "must be above {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be below {lt}",
    "less_than_equal": "must be at most {le}",
    "literal_error": "must be {expected}",
    "invalid_key": "a key must be text",
    "too_long": "at most {max_length} may be given",
    "too_short": "at least {min_length} must be given",
    "string_type": "text is needed",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must match {pattern}",
}
_OTHER = "is not what is needed here"  # a type of error that only a plug-in's model can have

MAX_PROBLEMS = 50  # most problems that are reported of one section
MAX_COMPARED, MAX_COMPARED_LENGTH = 1000, 100
"""Names that are compared with a wrong one, and their length: comparing takes time by the square of the length."""
_KINDS = {bool: "true or false", int: "a number", float: "a number", str: "text", list: "a list", dict: "a mapping"}


class _Brief(reprlib.Repr):
    """Short texts of values, with the words of YAML and JSON."""

    def repr_NoneType(self, value: None, level: int) -> str:
        return "null"

    def repr_bool(self, value: bool, level: int) -> str:
        return "true" if value else "false"


_brief = _Brief()
_brief.maxstring = _brief.maxother = _brief.maxlong = 60
_brief.maxlevel, _brief.maxlist, _brief.maxdict = 3, 4, 4


def shown(value: object) -> str:
    """A short text of a value for a message; with YAML's aliases a few lines can hold an enormous value."""
    return _brief.repr(value)


def kind_of(value: object) -> str:
    """Type of a value, in the words of a reader of YAML or JSON; the value itself might be a secret of its file."""
    return "nothing" if value is None else _KINDS.get(type(value), type(value).__name__)


def words(problem: Mapping[str, Any], names: str = "") -> str:
    """A problem that pydantic found, in our words: `must be at most 2 (got 3)`; `names` stand before the value."""
    if problem["type"] in ("value_error", "assertion_error"):
        return str(problem["msg"]).removeprefix("Value error, ")
    facts = problem.get("ctx", {}).items()
    numbers = {key: f"{value:.12g}" if isinstance(value, float) else value for key, value in facts}
    text = problem["msg"] if problem["type"] == "needed" else _WORDS.get(problem["type"], _OTHER).format(**numbers)
    return f"{text}{names} (got {shown(problem['input'])})"


def describe(error: ValidationError, model: type[BaseModel], *prefix: object) -> list[str]:
    """One line for each problem that pydantic found, such as `cameras.C0.skew: a number is needed (got 'x')`.
    `prefix` are the keys that lead to the model in the file."""
    lines, items = [], error.errors(include_url=False)
    for item in items[:MAX_PROBLEMS]:
        location = item["loc"]
        path = join_path(*prefix, *location)
        if location and location[-1] == "[key]":
            path = join_path(*prefix, *map(str, location[:-1]))
            lines.append(f"{path}: a name must be text: put it in quotes")
        elif item["type"] == "extra_forbidden":
            section = model_at(model, location[:-1])
            hint = nearest_key(str(location[-1]), _keys_of(section))
            lines.append(f"{path}: unknown key" + (f" ({hint})" if hint != "none are defined" else ""))
        elif item["type"] == "missing":
            lines.append(f"{path}: missing" + f" (got {shown(item['input'])})" * isinstance(location[-1], int))
        else:
            keys = _keys_of(model_at(model, location)) if item["type"] == "model_type" else []
            names = f": {', '.join(keys[:8])}{', …' if len(keys) > 8 else ''}" if keys else ""
            lines.append(f"{path}: {words(item, names)}")
    if len(items) > MAX_PROBLEMS:
        lines.append(f"… and {len(items) - MAX_PROBLEMS:,} more problems in {join_path(*prefix) or 'the file'}")
    return lines


def _keys_of(model: Any) -> list[str]:
    return [field.alias or name for name, field in getattr(model, "model_fields", {}).items()]


CONDITIONS = "conditions"  # name of the shipped folder, with the conditions that the thesis measured


def conditions_in(folder: StrPath = CONDITIONS) -> dict[str, Path]:
    """The detector files of a folder by their names, without their endings; `conditions` is the shipped folder. Raises
    InputError if there is no such folder, or no detector file in it."""
    place = data_folder("scenes") / "detectors" / CONDITIONS if str(folder) == CONDITIONS else Path(folder)
    files = {path.stem: path for path in sorted(place.glob("*.yaml"))} if place.is_dir() else {}
    if not files:
        wanted = f"give '{CONDITIONS}' for the shipped ones, or a folder with detector files (*.yaml)"
        raise InputError(f"detectors in {folder}", ["there are none: " + wanted])
    return files


def find_condition(name: str, folder: StrPath = CONDITIONS) -> Path:
    """The detector file of a condition; see `conditions_in`. Raises InputError if there is none of this name."""
    files = conditions_in(folder)
    if name not in files:
        alike = [condition for condition in files if name in condition]
        hint = f"known: {', '.join(alike)}" if alike else nearest(name, files)
        raise InputError(f"detectors in {folder}", [f"there is no '{name}' ({hint})"])
    return files[name]
