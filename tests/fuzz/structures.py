"""Changes to what JSON and YAML files hold: one value, one key or one entry becomes another."""

import contextlib
import functools
import json
import random
import re
from collections.abc import Callable
from typing import Any

import yaml

from tests.fuzz.texts import JSON, TEXTS, YAML, Literal, change_bytes, odd_value

REPEATS = (2, 3, 3, 3, 10, 10, 10, 30, 30, 1000)
_DEEPER = 0.88
_MARK = re.compile(r'"@@([0-9a-f]*)@@"')


class _Again(str):
    """A key that a mapping can have beside the same key."""

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other


@functools.lru_cache(maxsize=512)
def _parsed(content: bytes, form: str) -> Any:
    """What a file holds; None if it cannot be read, or has aliases, which may stand for any amount."""
    if form == YAML and b"*" in content:
        return None
    try:
        text = content.decode("utf-8")
        if form == YAML and text.startswith("{"):
            with contextlib.suppress(ValueError):
                return json.loads(text)  # much faster
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        return json.loads(text) if form == JSON else yaml.load(text, loader)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, yaml.YAMLError):
        return None


def written(tree: Any) -> bytes:
    """JSON, which is YAML in flow style too, with literals as they are."""

    def marked(value: Any) -> Any:
        if isinstance(value, Literal):
            return f"@@{value.encode('utf-8', 'surrogatepass').hex()}@@"
        if isinstance(value, dict):
            return {_key(key): marked(inner) for key, inner in value.items()}
        return [marked(inner) for inner in value] if isinstance(value, list) else value

    def _key(key: Any) -> str:
        return marked(key) if isinstance(key, Literal) else key if isinstance(key, str) else str(key)

    text = json.dumps(marked(tree), default=str)
    plain = _MARK.sub(lambda found: bytes.fromhex(found[1]).decode("utf-8", "surrogatepass"), text)
    return plain.encode("utf-8", "surrogatepass")


def change_structure(rng: random.Random, content: bytes, others: list[bytes], form: str = JSON) -> bytes:
    """The file with one thing changed, YAML in flow style; its bytes if it holds no mapping or list any more."""
    tree = _parsed(content, form)
    return written(_changed(rng, tree, form)) if isinstance(tree, dict | list) else change_bytes(rng, content, [])


def change_json_line(rng: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """One thing changed in one line of a file of JSON Lines."""
    lines = content.split(b"\n")
    place = rng.randrange(len(lines))
    lines[place] = change_structure(rng, lines[place], others)
    return b"\n".join(lines)


def _changed(rng: random.Random, node: Any, form: str) -> Any:
    """A copy with one change at a random place."""
    if not isinstance(node, dict | list) or not node or rng.random() > _DEEPER:
        return odd_value(rng, node, form)
    place = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
    if rng.random() < 0.2:
        change = rng.choice(_OF_MAPPINGS if isinstance(node, dict) else _OF_LISTS)
        return change(rng, node, place, form)
    copy: Any = node.copy()
    copy[place] = _changed(rng, node[place], form)
    return copy


def _remove(rng: random.Random, node: Any, place: Any, form: str) -> Any:
    copy = node.copy()
    del copy[place]
    return copy


def _twice(rng: random.Random, node: dict[Any, Any], place: Any, form: str) -> Any:
    value = node[place] if rng.random() < 0.5 else odd_value(rng, node[place], form)
    return {**node, _Again(place): value}


def _rename(rng: random.Random, node: dict[Any, Any], place: Any, form: str) -> Any:
    text = f"{place}"
    name = rng.choice((rng.choice(TEXTS), f"{text}x", text[:-1], f" {text}", text.upper(), rng.choice(list(node))))
    return {name if key == place else key: value for key, value in node.items()}


def _raw_key(rng: random.Random, node: dict[Any, Any], place: Any, form: str) -> Any:
    keys = ("1", "null", "~", "[1]", "{a: 1}", "<<", "? x", "!!int 1", "*a", "&a b", "1.5", "true", ".nan")
    key = Literal(rng.choice((*keys, "2024-01-01") if form == YAML else ("1", "null", "'a'", "a", "")))
    return {**node, key: node[place]}


def _swap(rng: random.Random, node: Any, place: Any, form: str) -> Any:
    copy, other = node.copy(), rng.choice(list(node) if isinstance(node, dict) else range(len(node)))
    copy[place], copy[other] = copy[other], copy[place]
    return copy


def _nest(rng: random.Random, node: list[Any], place: Any, form: str) -> Any:
    copy = node.copy()
    copy[place] = node
    return copy


Change = Callable[[random.Random, Any, Any, str], Any]
"""Another mapping or list, from one, the place of a value in it, and the form of its file."""
_OF_MAPPINGS: tuple[Change, ...] = (
    *(_remove, _remove, _twice, _rename, _raw_key),
    lambda rng, node, place, _: {**node, **{f"{place}{n}": node[place] for n in range(rng.choice(REPEATS))}},
    lambda rng, node, place, form: {**node, rng.choice(TEXTS): odd_value(rng, node[place], form)},
    _swap,
    lambda rng, node, place, form: dict(reversed(node.items())),
    lambda rng, node, place, form: list(node.values()),
)
_OF_LISTS: tuple[Change, ...] = (
    *(_remove, _remove),
    lambda rng, node, place, form: node[:place] + [node[place]] * rng.choice(REPEATS) + node[place + 1 :],
    lambda rng, node, place, form: [*node[:place], odd_value(rng, node[place], form), *node[place:]],
    *(_swap, _nest),
    lambda rng, node, place, form: node[::-1],
    lambda rng, node, place, form: {str(index): value for index, value in enumerate(node)},
)
