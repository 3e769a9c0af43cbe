# SPDX-License-Identifier: Apache-2.0
"""Proof that the node tests see: the package with one safeguard of the ray hierarchies taken away fails them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[4]
_GPU = "shadow_tracer/gpu"
_TREE, _CONES = "accelerators/cone_hierarchy/", "accelerators/paper_hierarchy/"

# the tests that have to fail; and file, what stands there, what is put there instead
_MUTANTS = {
    "half-angles from an arc cosine": (
        _CONES + "test_cone_nodes.py",
        [
            (
                _CONES + "cones.py",
                "2.0 * wp.atan2(wp.length(a - b), wp.length(a + b))",
                "wp.acos(wp.min(wp.dot(a, b), 1.0))",
            )
        ],
    ),
    "corners projected wherever they are": (
        _TREE + "test_box_nodes.py",
        [
            (
                "exact/faces.h",
                "bounded = Lanes::bits((front > 0x1p-18f * corners.reach) & corners.near());",
                "bounded = Lanes::ALL;",
            )
        ],
    ),
    "accepted by the edges alone": (
        _TREE + "test_box_nodes.py",
        [("exact/box.h", " & (middle[3] - reach[3] + far > plane)", "")],
    ),
    "no pads": (
        _TREE + "test_box_nodes.py",
        [
            ("exact/pads.h", "return 2.0f * error;", "return 0.0f * error;"),
            ("exact/pads.h", "return 7.0f * (slope + offset);", "return 0.0f * slope;"),
            (_TREE + "boxes.py", "_PAD = 2.0**-21", "_PAD = 0.0"),
        ],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_node_tests_fail(mutant: str, tmp_path: Path) -> None:
    tests, changes = _MUTANTS[mutant]
    for folder in ("shadow_tracer", "test"):
        shutil.copytree(_ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(_ROOT / "pyproject.toml", tmp_path)
    for name, there, instead in changes:
        path = tmp_path / _GPU / name
        code = path.read_text(encoding="utf-8")
        assert code.count(there) == 1, f"the safeguard has moved from {name}: update this test"
        path.write_text(code.replace(there, instead), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"test/gpu/{tests}"],
        cwd=tmp_path,
        env={**os.environ, "WARP_CACHE_PATH": str(tmp_path / "kernels"), "SHADOW_TRACER_TEST_DEVICES": "cpu"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 1 and "AssertionError" in done.stdout, done.stdout + done.stderr
