# SPDX-License-Identifier: Apache-2.0
"""Proof that the tests of the bias see: without the distances that it needs they fail."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_MUTANTS: dict[str, Change] = {
    "distances as float64 has them": ("exact/decision.h", "bias > 0.0 ? 0x1p-20 : 1.0e-15", "1.0e-15"),
    "exact signs, and no exact distances": ("exact/determinant.h", "value = add(value, sum.h[i]);", ";"),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    failing_tests([_MUTANTS[mutant]], "exact/test_bias.py", "brute_force or bvh", tmp_path, kernels)
