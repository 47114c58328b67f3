"""Mutants of a module: its source with one small change each, as a wrong line of code would have it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, replace

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
PAIRS = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("argmin", "argmax"),
    ("any", "all"),
    ("floor", "ceil"),
    ("sin", "cos"),
    ("zeros", "ones"),
)
SWAPPED = dict(PAIRS) | {second: first for first, second in PAIRS}
UNWRAPPED = ("abs", "clip", "sort", "sqrt", "swapaxes")
"""Functions that are left out: only their first argument stays."""


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        index: Among the changes of its module.
        function: Qualified name of the outermost function it is in; empty for the body of a module or class.
        lines: First and last line of the statement that changes.
        change: Old code → new code.
    """

    index: int
    function: str
    lines: tuple[int, int]
    change: str


@dataclass(frozen=True)
class _Place:
    function: str = ""
    classes: str = ""
    lines: tuple[int, int] = (1, 1)

    def within(self, node: ast.AST, field: str) -> _Place:
        """The place of a child that is in a field of its parent."""
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno
            here = replace(self, lines=(node.lineno, max(node.lineno, last or 0)))
            if isinstance(node, ast.ClassDef) and not self.function:
                return replace(here, classes=f"{self.classes}{node.name}.")
            return here
        return self

    def body_of(self, node: ast.AST, field: str) -> _Place:
        """The place of what is in a field of a node at this place."""
        if isinstance(node, ast.FunctionDef) and field == "body" and not self.function:
            return replace(self, function=f"{self.classes}{node.name}")
        return self


@dataclass(frozen=True)
class _Edit:
    """A node of a tree, where it hangs, and what may take its place."""

    parent: ast.AST
    field: str
    index: int | None
    old: ast.AST
    new: ast.AST | None
    place: _Place
    around: ast.AST | None

    def make(self) -> None:
        """Change the tree."""
        if self.index is None:
            setattr(self.parent, self.field, self.new)
        elif self.new is None:
            del getattr(self.parent, self.field)[self.index]
        else:
            getattr(self.parent, self.field)[self.index] = self.new

    def said(self) -> str:
        """The change, with what is around a single number or name."""
        before = ast.unparse(self.old)
        if self.around is None or len(before) >= 12:
            after = ast.unparse(self.new) if self.new else "nothing"
        else:
            before = ast.unparse(self.around)
            self.make()
            after = ast.unparse(self.around)
        same = next((place for place, (a, b) in enumerate(zip(before, after, strict=False)) if a != b), 0)
        return f"{_short(before, same)} → {_short(after, same)}"


def _short(code: str, place: int) -> str:
    """Code on one line, or what is at a place in it if it is long."""
    start = max(0, place - 40) if len(code) > 100 else 0
    line = " ".join(code[start : start + 100].split())
    return f"{'…' if start else ''}{line}{'…' if start + 100 < len(code) else ''}"


def mutants_of(source: str) -> list[Mutant]:
    """Every change of a module, in order of its lines."""
    count = sum(1 for _ in _edits(ast.parse(source)))
    found = []
    for index in range(count):
        edit = _edit(ast.parse(source), index)
        found.append(Mutant(index, edit.place.function, edit.place.lines, edit.said()))
    return found


def mutated(source: str, index: int) -> ast.Module:
    """The tree of a module with one change."""
    tree = ast.parse(source)
    _edit(tree, index).make()
    return ast.fix_missing_locations(tree)


def _edit(tree: ast.Module, index: int) -> _Edit:
    for number, edit in enumerate(_edits(tree)):
        if number == index:
            if edit.new is not None:
                ast.copy_location(edit.new, edit.old)
                ast.fix_missing_locations(edit.new)
            return edit
    raise IndexError(index)


def _edits(tree: ast.Module) -> Iterator[_Edit]:
    return _edits_below(tree, _Place(), None)


def _edits_below(node: ast.AST, place: _Place, around: ast.AST | None) -> Iterator[_Edit]:
    if isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign | ast.arguments):
        around = node
    elif isinstance(node, ast.stmt):
        around = None
    elif isinstance(node, ast.expr) and not isinstance(node, ast.Slice | ast.Tuple | ast.List | ast.UnaryOp):
        around = node
    for field, value in ast.iter_fields(node):
        many = isinstance(value, list)
        for index, child in enumerate(value) if many else [(0, value)]:
            if not isinstance(child, ast.AST) or _left_alone(node, field, child):
                continue
            here = place.body_of(node, field).within(child, field)
            for new in _instead_of(child, node, field):
                yield _Edit(node, field, index if many else None, child, new, here, around)
            if not isinstance(child, ast.Raise):  # what an error says is no result
                yield from _edits_below(child, here, around)


def _left_alone(parent: ast.AST, field: str, child: ast.AST) -> bool:
    if field in ("annotation", "returns", "decorator_list"):
        return True
    if isinstance(parent, ast.ClassDef) and field in ("bases", "keywords"):
        return True
    if isinstance(child, ast.Import | ast.ImportFrom | ast.JoinedStr):
        return True
    if isinstance(child, ast.Call) and ast.unparse(child.func) == "TypeVar":
        return True
    return isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)  # a docstring


def _instead_of(node: ast.AST, parent: ast.AST, field: str) -> Iterator[ast.AST | None]:
    if isinstance(node, ast.stmt):
        yield from _statements(node)
    elif isinstance(node, ast.keyword) and node.arg is not None:
        yield None
    elif isinstance(node, ast.expr):
        yield from _conditions(node, parent, field)
        yield from _expressions(node)


def _statements(node: ast.stmt) -> Iterator[ast.AST]:
    if isinstance(node, ast.Return) and ast.unparse(node) not in ("return", "return None"):
        yield ast.Return(ast.Constant(None))
    elif isinstance(node, ast.Assign):
        if isinstance(node.targets[0], ast.Subscript | ast.Attribute):
            yield ast.Pass()
    elif isinstance(node, ast.AugAssign):
        yield ast.Pass()
        if type(node.op) in OPERATORS:
            yield ast.AugAssign(node.target, OPERATORS[type(node.op)](), node.value)
    elif isinstance(node, ast.Expr | ast.Raise | ast.Break | ast.Continue):
        yield ast.Pass()


def _conditions(node: ast.expr, parent: ast.AST, field: str) -> Iterator[ast.AST | None]:
    if field == "test" and isinstance(parent, ast.If | ast.While | ast.IfExp):
        opposite = isinstance(node, ast.Compare) and not isinstance(node.ops[0], ast.Lt | ast.LtE | ast.Gt | ast.GtE)
        if not opposite and not isinstance(node, ast.UnaryOp):  # whose opposites come anyway
            yield ast.UnaryOp(ast.Not(), node)
    elif field == "ifs":
        yield ast.Constant(True)
    elif field in ("lower", "upper") and not isinstance(node, ast.Constant):
        yield None


def _expressions(node: ast.expr) -> Iterator[ast.AST]:
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            others = [*node.ops[:place], COMPARISONS[type(operator)](), *node.ops[place + 1 :]]
            yield ast.Compare(node.left, others, node.comparators)
    elif isinstance(node, ast.BinOp):
        if type(node.op) in OPERATORS:
            yield ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    elif isinstance(node, ast.Constant):
        yield from _constants(node.value)
    elif isinstance(node, ast.Attribute) and node.attr == "T":
        yield node.value
    elif isinstance(node, ast.Call):
        yield from _calls(node)


def _constants(value: object) -> Iterator[ast.AST]:
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int):
        yield ast.Constant(value + 1)
    elif isinstance(value, float):
        yield ast.Constant(2 * value or 1.0)
    elif isinstance(value, str):
        yield ast.Constant(value + "?")


def _calls(node: ast.Call) -> Iterator[ast.AST]:
    function = node.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    if name in UNWRAPPED and node.args:
        yield node.args[0]
    if name in SWAPPED:
        other: ast.expr = ast.Name(SWAPPED[name], ast.Load())
        if isinstance(function, ast.Attribute):
            other = ast.Attribute(function.value, SWAPPED[name], ast.Load())
        yield ast.Call(other, node.args, node.keywords)
