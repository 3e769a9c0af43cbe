# SPDX-License-Identifier: Apache-2.0
"""Of each test function a few of its cases: enough for the inner loop, ``make quick``, to notice what broke."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import pytest


def choose(names: Sequence[str], most: int) -> list[str]:
    """Of node ids at most ``most`` per function, in their order: by a hash of the id, so that the choice is the same in
    every process and every order, and neighbouring functions take unlike parameters."""
    cases: dict[str, list[str]] = {}
    for name in names:
        cases.setdefault(name.partition("[")[0], []).append(name)
    kept = {name for found in cases.values() for name in sorted(found, key=_hash)[:most]}
    return [name for name in names if name in kept]


def _hash(name: str) -> int:
    return zlib.crc32(name.encode())


class Few:
    """Leaves out all cases but a few of each function, after marks and names have left out theirs."""

    def __init__(self, most: int) -> None:
        self._most = most

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        kept = set(choose([item.nodeid for item in items], self._most))
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in kept])
        items[:] = [item for item in items if item.nodeid in kept]
