# SPDX-License-Identifier: Apache-2.0
"""What mutants change is still there, once: a safeguard that has moved is noticed in a second, and not when its mutant
comes to run."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mutants import Change

_TEST = Path(__file__).resolve().parent
_GPU = _TEST.parent / "shadow_tracer" / "gpu"
_FILES = sorted(_TEST.rglob("test_*safeguards_off.py"))


def _changes(value: Any) -> Iterator[Change]:
    """All that look like one, wherever they lie in a module's tables."""
    if isinstance(value, dict):
        value = tuple(value.values())
    if isinstance(value, tuple | list):
        if len(value) == 3 and all(isinstance(part, str) for part in value) and value[0].endswith((".py", ".h")):
            yield tuple(value)
        else:
            for part in value:
                yield from _changes(part)


def _tables(path: Path) -> dict[str, Any]:
    spec = importlib.util.spec_from_file_location(f"mutants_of_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return {name: value for name, value in vars(module).items() if name.startswith("_") and not name.startswith("__")}


def test_there_are_mutants() -> None:
    assert len(_FILES) > 10
    assert sum(1 for path in _FILES for _ in _changes(tuple(_tables(path).values()))) > 100


@pytest.mark.parametrize("path", _FILES, ids=lambda path: str(path.relative_to(_TEST)))
def test_what_they_change_is_there_once(path: Path) -> None:
    for name, there, instead in _changes(tuple(_tables(path).values())):
        assert (_GPU / name).read_text(encoding="utf-8").count(there) == 1, f"{name}: {there!r} has moved"
        assert there != instead
