# SPDX-License-Identifier: Apache-2.0
"""The campaign of adversarial scenes: it finds nothing, and it would find one wrong bit."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import adversaries
import numpy as np
import pytest

from shadow_tracer import State


def test_scenes_are_hard_and_the_same_again() -> None:
    first, again = (list(itertools.islice(adversaries.scenes(3), 3)) for _ in range(2))
    for one, two in zip(first, again, strict=True):
        assert np.array_equal(one.points, two.points) and np.array_equal(one.depth, two.depth)
    rows = adversaries.run(1e5, 3, ("light_grid/packed",), 1)
    assert {row["tracer"] for row in rows} == {"light_grid/packed", "brute_force/filtered", "brute_force/float64"}
    for row in rows:
        assert row["samples"] > 0 and 0.05 < row["in shadow"] < 0.95
    assert rows[0]["samples"] >= 1e5 and rows[0]["retested per pixel"] > 0.001, "rays pass edges within roundings"


def test_one_wrong_bit_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    answers = adversaries.Campaign._at

    def wrong(self: Any, name: str, scene: adversaries.Scene, points: Any) -> Any:
        found = answers(self, name, scene, points)
        if name == "bvh/sah":
            found[1, 7] = State.LIT if found[1, 7] != State.LIT else State.SHADOWED
        return found

    monkeypatch.setattr(adversaries.Campaign, "_at", wrong)
    with pytest.raises(SystemExit, match="^bvh/sah: 1 of [0-9]+ differ"):
        adversaries.run(1e5, 3, ("light_grid/packed", "bvh/sah"), 1)
    with np.load(tmp_path / "adversary.npz") as kept:
        assert kept["points"].shape[1] == 3
