# SPDX-License-Identifier: Apache-2.0
"""The other numpy of ``last_bits.py`` differs from numpy in last bits, always in the same, and in nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import last_bits
import numpy as np
import pytest

_PROGRAM = """
import sys
sys.path.insert(0, {test!r})
import numpy as np
plain = np.random.default_rng(7).normal(size=(500, 3))
before = [np.sin(plain), np.linalg.norm(plain, axis=1), np.exp(plain[0, 0])]
import last_bits
last_bits.install({seed})
rng = np.random.default_rng(7)
drawn = rng.normal(size=(500, 3))
for now, then in zip([drawn, np.sin(plain), np.linalg.norm(plain, axis=1)], [plain, *before[:2]]):
    steps = now.view(np.int64) - then.view(np.int64)
    assert set(steps.ravel().tolist()) == {{-1, 0, 1}}, set(steps.ravel().tolist())
assert np.array_equal(np.sin(plain), np.sin(plain)) and isinstance(rng, np.random.Generator)
assert np.cos(0.0) == 1.0 and np.linalg.norm([3.0, 4.0]) == 5.0 and np.isnan(np.sin(np.nan))
assert np.random.default_rng(rng) is rng and np.hypot.outer(plain[0], plain[0]).shape == (3, 3)
print(np.sin(plain).tobytes().hex())
"""


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_neighbours_are_neighbours(kind: type) -> None:
    """Of two thirds, either way; numbers of few digits, infinities and NaN stay, and so does what is no such array."""
    values = np.random.default_rng(3).random(3000).astype(kind)
    moved = last_bits.neighbours(values, 1)
    steps = moved.view(f"i{moved.itemsize}") - values.view(f"i{moved.itemsize}")
    assert set(steps.tolist()) == {-1, 0, 1} and (steps != 0).mean() == pytest.approx(2 / 3, abs=0.05)
    assert not np.array_equal(moved, last_bits.neighbours(values, 2))
    special = np.array([0.0, -0.0, 1.0, -2.5, 4096.0, np.inf, np.nan], kind)
    assert last_bits.neighbours(special, 1).tobytes() == special.tobytes()
    whole = np.arange(5)
    assert last_bits.neighbours(whole, 1) is whole
    assert last_bits.neighbours(kind(0.1), 1).dtype == kind


def test_it_takes_the_place_of_numpy() -> None:
    """In a separate process, as it stays; the seed chooses."""
    found = set()
    for seed in (1, 2, 2):
        code = _PROGRAM.format(test=str(Path(__file__).parent), seed=seed)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        found.add(done.stdout)
    assert len(found) == 2
