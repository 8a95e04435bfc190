"""Single mutants of Python source: small faults such as a negated comparison, a moved boundary or a wrong sign.

Text that no test should pin is left alone: docstrings, messages (f-strings and whatever is raised), annotations,
decorators, asserts, ``__all__`` and the methods that print an object.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["Edit", "apply", "lines", "sites"]

NEGATED: dict[type[ast.cmpop], str] = {
    ast.Lt: ">=",
    ast.LtE: ">",
    ast.Gt: "<=",
    ast.GtE: "<",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
MOVED: dict[type[ast.cmpop], str] = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">"}
SWAPPED: dict[type[ast.operator], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.FloorDiv: "*",
    ast.Mod: "//",
    ast.Pow: "*",
    ast.BitAnd: "|",
    ast.BitOr: "&",
}
COMPARISON = re.compile(r"not\s+in\b|is\s+not\b|in\b|is\b|[<>=!]=|[<>]")
ARITHMETIC = re.compile(r"\*\*|//|[-+*/%&|]")
CONNECTIVE = re.compile(r"\b(?:and|or)\b")
PREFIX = re.compile(r"not\b\s*|[-~]\s*")
PRINTING = frozenset({"__repr__", "__str__", "_repr_html_", "__rich__", "__rich_console__"})
BUILTIN_TYPES = frozenset({"bool", "bytes", "dict", "float", "int", "list", "set", "str", "tuple"})
UNTESTED_ARGUMENTS = frozenset({"strict", "stacklevel"})
"""Keyword arguments that change nothing unless there is another fault."""


@dataclass(frozen=True)
class Edit:
    """One mutant: ``source[start:end]``, in bytes of UTF-8, becomes ``text``."""

    kind: str
    start: int
    end: int
    text: str


def apply(source: str, edit: Edit) -> str:
    """The mutated source."""
    raw = source.encode()
    return (raw[: edit.start] + edit.text.encode() + raw[edit.end :]).decode()


def lines(source: str, edit: Edit) -> tuple[int, str, str]:
    """The number of the first line that changes, its text and its mutated text."""
    above = source.encode()[: edit.start].count(b"\n")
    before, after = (text.split("\n")[above].strip() for text in (source, apply(source, edit)))
    return above + 1, before, after


def sites(source: str) -> list[tuple[Edit, ...]]:
    """The places of a module that can be mutated, in the order of its lines, each with its one or two mutants."""
    finder = _Finder(source)
    finder.visit(ast.parse(source))
    return sorted((site for site in finder.found if site), key=lambda site: (site[0].start, site[0].end))


class _Finder(ast.NodeVisitor):
    """Collects the sites of a module; skipped nodes are not visited, so neither are their children."""

    def __init__(self, source: str) -> None:
        self.raw = source.encode()
        self.lines = [0]
        for line in self.raw.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line))
        self.found: list[tuple[Edit, ...]] = []

    def _start(self, node: ast.expr) -> int:
        return self.lines[node.lineno - 1] + node.col_offset

    def _end(self, node: ast.expr) -> int:
        assert node.end_lineno is not None and node.end_col_offset is not None  # noqa: PT018
        return self.lines[node.end_lineno - 1] + node.end_col_offset

    def _token(self, start: int, end: int, pattern: re.Pattern[str], *mutants: tuple[str, str]) -> None:
        """Record a site: the first match of ``pattern`` between two offsets, and what may stand there instead."""
        match = pattern.search(self.raw[start:end].decode())
        if match is not None:  # what precedes an operator is ASCII: spaces, parentheses, or the start of the operand
            at = start + match.start()
            self.found.append(tuple(Edit(kind, at, at + len(match[0]), text) for kind, text in mutants))

    # --- left alone

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name not in PRINTING:
            for child in [*node.args.defaults, *(d for d in node.args.kw_defaults if d is not None), *node.body]:
                self.visit(child)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for child in node.body:
            self.visit(child)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        if not any(isinstance(target, ast.Name) and target.id == "__all__" for target in node.targets):
            self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in UNTESTED_ARGUMENTS:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """A message."""

    def visit_Assert(self, node: ast.Assert) -> None:
        """Says what holds anyway."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """A message."""

    # --- mutated

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, operator, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
            mutants = [("comparison negated", NEGATED[type(operator)])]
            if type(operator) in MOVED:
                mutants.append(("boundary moved", MOVED[type(operator)]))
            self._token(self._end(left), self._start(right), COMPARISON, *mutants)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        other = "or" if isinstance(node.op, ast.And) else "and"
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._token(self._end(left), self._start(right), CONNECTIVE, ("and/or swapped", other))
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if type(node.op) in SWAPPED and not any(map(_not_numeric, (node.left, node.right))):
            mutant = ("operator changed", SWAPPED[type(node.op)])
            self._token(self._end(node.left), self._start(node.right), ARITHMETIC, mutant)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if type(node.op) in SWAPPED and not _not_numeric(node.value):
            mutant = ("operator changed", SWAPPED[type(node.op)])
            self._token(self._end(node.target), self._start(node.value), ARITHMETIC, mutant)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        kind = "not dropped" if isinstance(node.op, ast.Not) else "sign dropped"
        self._token(self._start(node), self._end(node), PREFIX, (kind, ""))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            texts: Sequence[str] = [str(not value)]
        elif isinstance(value, (int, float)):
            texts = [repr(value + 1), repr(value - 1)]
        else:
            return
        kind = "constant changed"
        self.found.append(tuple(Edit(kind, self._start(node), self._end(node), text) for text in texts))

    def _condition(self, node: ast.expr) -> None:
        """Negate a condition that has no mutant of its own kind at its top."""
        if not isinstance(node, (ast.Compare, ast.BoolOp, ast.UnaryOp, ast.Constant)):
            start, end = self._start(node), self._end(node)
            text = self.raw[start:end].decode()
            self.found.append((Edit("condition negated", start, end, f"(not ({text}))"),))

    def visit_If(self, node: ast.If | ast.While | ast.IfExp) -> None:
        if not (isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"):
            self._condition(node.test)
            self.generic_visit(node)

    visit_While = visit_IfExp = visit_If  # noqa: N815

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self._condition(test)
        self.generic_visit(node)


def _not_numeric(node: ast.expr) -> bool:
    """Whether an operand is text, a sequence or a type: another operator there would fail at once, and say nothing."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, (str, bytes, type(None)))
    if isinstance(node, ast.Name):
        return node.id in BUILTIN_TYPES or (node.id[0].isupper() and not node.id.isupper())
    return isinstance(node, (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp, ast.Dict, ast.Set)) or (
        isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and _not_numeric(node.value)
    )
