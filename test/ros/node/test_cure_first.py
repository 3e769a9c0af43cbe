# SPDX-License-Identifier: Apache-2.0
"""Every message of /diagnostics that is no OK names what helps, and that within its first 120 characters: `ros2 topic
echo` cuts there, and so do most viewers. Read from the source, as far as texts are fixed there."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from shadow_tracer.ros.diagnostics import READ_FIRST, cure_first

FOLDER = Path(__file__).parents[3] / "shadow_tracer" / "ros"
INSERTED = "/camera/depth"  # stands for what differs from case to case
RETURNING = {"_doubts", "_loss", "mismatch"}  # functions whose strings are messages


class Texts(ast.NodeVisitor):
    """Collects the messages of a module."""

    def __init__(self, tree: ast.Module) -> None:
        self.found: list[tuple[int, str]] = []
        self._functions: list[ast.FunctionDef] = []
        self._constants = tree
        self.visit(tree)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._functions.append(node)
        self.generic_visit(node)
        self._functions.pop()

    def visit_Call(self, node: ast.Call) -> None:
        if isinstance(node.func, ast.Name) and node.func.id == "Missing" and len(node.args) > 1:
            self._add(node.args[1])
        self.generic_visit(node)

    def visit_Return(self, node: ast.Return) -> None:
        value = node.value
        if (
            isinstance(value, ast.Tuple)
            and value.elts
            and isinstance(value.elts[0], ast.Name)
            and value.elts[0].id in ("WARN", "ERROR")
        ):
            self._add(value.elts[1])
        elif value is not None and self._functions and self._functions[-1].name in RETURNING:
            self._add(value)
        self.generic_visit(node)

    def _add(self, value: ast.expr) -> None:
        self.found += [(value.lineno, text) for text in self._texts(value) if len(text) > len(INSERTED)]

    def _texts(self, value: ast.expr, inside: bool = False) -> list[str]:
        """What an expression can be; nothing where that is not written here, its stand-in where it is only a part."""
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            return [value.value]
        if isinstance(value, ast.JoinedStr):
            texts = [""]
            for part in value.values:
                more = self._texts(part.value, True) if isinstance(part, ast.FormattedValue) else self._texts(part)
                texts = [text + end for text in texts for end in more or [INSERTED]]
            return texts
        if isinstance(value, ast.IfExp):
            return [*self._texts(value.body, inside), *self._texts(value.orelse, inside)]
        if isinstance(value, ast.Name):
            place = self._functions[-1] if self._functions else self._constants
            for tree in (place, self._constants):
                given = [
                    made.value
                    for made in ast.walk(tree)
                    if isinstance(made, ast.Assign)
                    and any(isinstance(t, ast.Name) and t.id == value.id for t in made.targets)
                ]
                texts = [text for one in given for text in self._texts(one, inside)]
                if texts:
                    return texts
        return [INSERTED] if inside else []


def messages() -> Iterator[tuple[str, str]]:
    for path in sorted(FOLDER.rglob("*.py")):
        for line, text in Texts(ast.parse(path.read_text(encoding="utf-8"))).found:
            yield f"{path.name}:{line}", text


MESSAGES = list(messages())
QUOTED = next(place for place, text in MESSAGES if text.startswith("no camera_info has arrived"))


def test_the_messages_are_found() -> None:
    assert len(MESSAGES) > 40 and len({text for _, text in MESSAGES}) > 35
    texts = "\n".join(text for _, text in MESSAGES)
    for part in (
        "no camera_info has arrived",
        "no mesh: every valid pixel",
        "use_sim_time is true",
        "no light is enabled",
    ):
        assert part in texts


@pytest.mark.parametrize(("place", "text"), MESSAGES, ids=[f"{place} {text[:40]}" for place, text in MESSAGES])
def test_what_helps_stands_within_the_first_120_characters(place: str, text: str) -> None:
    if text.endswith(f"see {INSERTED}: {INSERTED}"):  # it quotes another message, which is one of these
        text = f"{text[: -len(INSERTED)]}{dict(MESSAGES)[QUOTED]}"
    if text == f"the tracer cannot be made: {INSERTED}":  # of kernel_cache, see test_kernel_cache.py
        return
    wrong, found, cure = text.rpartition("; ")
    assert found and wrong and cure, f"{place}: expected 'what is wrong; what helps', got {text!r}"
    shown = cure_first(text)
    assert cure in shown[:READ_FIRST], f"{place}: {len(cure)} characters help, {shown!r}"
    assert wrong in shown, "nothing is lost"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("short; do this", "short; do this"),
        ("OK", "OK"),
        ("x" * 300, "x" * 300),
        ("x" * 110 + "; y" + "; do this", "do this - " + "x" * 110 + "; y"),
        ("x" * 111 + "; do this", "x" * 111 + "; do this"),
        ("x" * 112 + "; do this", "do this - " + "x" * 112),
    ],
)
def test_cure_first(text: str, shown: str) -> None:
    assert cure_first(text) == shown
