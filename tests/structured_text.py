"""An interpreter of the subset of Structured Text that the generated blocks use, over blark's syntax tree."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from blark import transform as st
from blark.parse import parse_source_code

FUNCTIONS = {
    "SIN": np.sin, "COS": np.cos, "SQRT": np.sqrt, "ABS": np.abs, "EXP": np.exp, "LN": np.log, "TAN": np.tan,
    "ATAN": np.arctan, "ASIN": np.arcsin, "ACOS": np.arccos, "EXPT": np.power,
    "SEL": lambda chosen, no, yes: yes if chosen else no, "LIMIT": lambda low, x, high: min(max(low, x), high),
}  # fmt: skip


@cache
def parsed(source: str) -> Any:
    """The syntax tree of a file with one function block; blark's parser takes seconds."""
    result = parse_source_code(source)
    if result.exception is not None:
        raise result.exception
    (block,) = result.transform().items
    assert isinstance(block, st.FunctionBlock)
    return block


class Block:
    """A function block with its variables; names are case-insensitive, as in the standard."""

    def __init__(self, source: str) -> None:
        self.block = parsed(source)
        self.variables: dict[str, Any] = {}
        self.types: dict[str, Any] = {}
        self.sections: dict[str, list[str]] = {}
        for section in self.block.declarations:
            for item in section.items:
                for declared in item.variables:
                    self._declare(type(section).__name__, str(declared.variable.name), item.init)

    def _declare(self, section: str, name: str, init: Any) -> None:
        name = name.lower()
        assert name not in self.variables, f"{name} is declared twice"
        self.sections.setdefault(section, []).append(name)
        if isinstance(init, st.ArrayTypeInitialization):
            shape = tuple(self._integer(r.stop) - self._integer(r.start) + 1 for r in init.spec.subranges)
            assert all(self._integer(r.start) == 1 for r in init.spec.subranges)
            kind = self._kind(init.spec.type.type_name)
            self.variables[name] = np.zeros(shape, kind)
            if init.value is not None:
                values = [self.value(e.element) for e in init.value.elements]
                assert len(values) == shape[0]
                self.variables[name][:] = values
        else:
            spec = init.spec.type if hasattr(init.spec, "type") else init.spec
            kind = self._kind(getattr(spec, "type_name", spec))
            self.variables[name] = kind(0) if init.value is None else kind(self.value(init.value))
        self.types[name] = kind

    @staticmethod
    def _kind(name: Any) -> Any:
        return {"LREAL": np.float64, "REAL": np.float32, "INT": np.int16, "BOOL": np.bool_}[str(name)]

    @staticmethod
    def _integer(node: Any) -> int:
        return int(str(node.value))

    def __call__(self, **inputs: Any) -> dict[str, Any]:
        for name, value in inputs.items():
            assert name in self.sections["InputDeclarations"]
            self.variables[name] = np.array(value, self.types[name])
        with np.errstate(all="ignore"):
            self.run(self.block.body.statements)
        return {n: np.copy(self.variables[n]) for n in self.sections["OutputDeclarations"]}

    def run(self, statements: Any) -> None:
        for statement in statements:
            getattr(self, f"_{type(statement).__name__}")(statement)

    def _AssignmentStatement(self, node: Any) -> None:
        value = self.value(node.expression)
        for target in node.variables:
            if isinstance(target, st.MultiElementVariable):
                name = str(target.name.name).lower()
                self.variables[name][self._subscripts(target, name)] = value
            else:
                name = str(target.name).lower()
                assert name in self.variables, f"{name} is not declared"
                assert not isinstance(self.variables[name], np.ndarray) or self.variables[name].ndim == 0
                self.variables[name] = self.types[name](value)

    def _IfStatement(self, node: Any) -> None:
        if self.value(node.if_expression):
            self.run(node.statements.statements)
            return
        for clause in node.else_ifs:
            if self.value(clause.if_expression):
                self.run(clause.statements.statements)
                return
        if node.else_clause is not None:
            self.run(node.else_clause.statements.statements)

    def _ForStatement(self, node: Any) -> None:
        name = str(node.control.name).lower()
        first, last = int(self.value(node.from_)), int(self.value(node.to))
        step = 1 if node.step is None else int(self.value(node.step))
        for i in range(first, last + (1 if step > 0 else -1), step):
            self.variables[name] = np.int16(i)
            self.run(node.statements.statements)

    def _subscripts(self, node: Any, name: str) -> tuple[int, ...]:
        (subscripts,) = node.elements
        found = tuple(int(self.value(s)) - 1 for s in subscripts.subscripts)
        assert all(0 <= i < n for i, n in zip(found, self.variables[name].shape, strict=True)), (
            f"{name}{found}"
        )
        return found

    def value(self, node: Any) -> Any:
        if isinstance(node, st.Integer):
            return int(str(node.value))
        if isinstance(node, st.Real):
            assert node.type_name in (None, "REAL")
            return np.float32(str(node.value)) if node.type_name else np.float64(str(node.value))
        if isinstance(node, st.ParenthesizedExpression):
            return self.value(node.expr)
        if isinstance(node, st.UnaryOperation):
            value = self.value(node.expr)
            return {"-": lambda: -value, "NOT": lambda: not value}[str(node.op)]()
        if isinstance(node, st.BinaryOperation):
            return self._binary(str(node.op), self.value(node.left), self.value(node.right))
        if isinstance(node, st.FunctionCall):
            return FUNCTIONS[str(node.name.name)](*(self.value(p.value) for p in node.parameters))
        if isinstance(node, st.MultiElementVariable):
            name = str(node.name.name).lower()
            return self.variables[name][self._subscripts(node, name)]
        assert isinstance(node, st.SimpleVariable), type(node)
        value = self.variables[str(node.name).lower()]
        return value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value

    @staticmethod
    def _binary(op: str, a: Any, b: Any) -> Any:
        types = {type(x) for x in (a, b) if isinstance(x, np.floating)}
        assert len(types) <= 1, "REAL and LREAL are mixed"
        if op == "/" and not float(b):
            return math.nan
        return {
            "+": lambda: a + b, "-": lambda: a - b, "*": lambda: a * b, "/": lambda: a / b, "<": lambda: a < b,
            ">": lambda: a > b, "<=": lambda: a <= b, ">=": lambda: a >= b, "=": lambda: a == b, "<>": lambda: a != b,
            "AND": lambda: a and b, "OR": lambda: a or b,
        }[op]()  # fmt: skip
