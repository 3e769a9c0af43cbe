# SPDX-License-Identifier: Apache-2.0
"""Proof that the tests of tiles and boxes see: the package with one safeguard of `packed` taken away fails them, in
both of its forms."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[4]
_GPU = "shadow_tracer/gpu"
_GRID = "accelerators/light_grid/"
_BOXES, _TILES, _CANDIDATES = "test_packed_boxes.py", "test_packed_tiles.py", "test_candidates.py"
_BOUNDS = ("u0", "u1", "v0", "v1")
_COVERED = "(g - h + *s.pt * t1 > plane)"

# the tests that have to fail and which of them are enough; and file, what stands there, what is put there instead
_MUTANTS: dict[str, tuple[str, str, list[tuple[str, str, str]]]] = {
    "pyramids without pads": (
        _CANDIDATES,
        "outermost",
        [(_GRID + "candidates.py", f"0x1p-20 * (1.0 + fabs({x}))", "0.0") for x in ("low", "high")],
    ),
    "the light lower than its rays": (
        _CANDIDATES,
        "all_around",
        [(_GRID + "candidates.py", "light < far[1] ? light - 0x1p-20 * fabs(light) : far[1]", "far[1]")],
    ),
    "a face as far as its nearest ray": (
        _CANDIDATES,
        "all_around",
        [(_GRID + "keys_wide.py", "far = axis[j] > far ? axis[j] : far;", "far = axis[j];")],
    ),
    "rays outside of the tiles forgotten": (
        _CANDIDATES,
        "shown_everything",
        [(_GRID + "candidates.py", "attempt > 0 or wild[1] > 0", "attempt > 0")],
    ),
    "boxes kept when the scene changes": (
        _CANDIDATES,
        "only_what",
        [("occluders/clusters.py", "self._made_for != self._scene.revision:", "self._made_for is None:")],
    ),
    "records kept when the light moves": (
        _CANDIDATES,
        "only_what",
        [(_GRID + "candidates.py", "if self._records.begin(light):", "if not self._made.numpy().any():")],
    ),
    "boxes without pads": (
        _TILES,
        "test_one_light and frustum and sun",
        [
            (_GRID + "packing.py", "_PAD = 2.0**-20", "_PAD = 0.0"),
            (_GRID + "packing_wide.py", "+ 0x1p-20f : -1.0e30f", "+ 0.0f : -1.0e30f"),
        ],
    ),
    "edges without pads": (
        _BOXES,
        "beside",
        [
            ("exact/faces.py", "it.edge = 2.0f * record[0][3];", "it.edge = 0.0f;"),
            (_GRID + "front_wide.py", "= 2.0f * at(3);", "= 0.0f * at(3);"),
        ],
    ),
    "planes without pads": (
        _BOXES,
        "vast-0",
        [
            ("exact/faces.py", "it.plane = 7.0f * (record[1][3] + record[2][3]);", "it.plane = 0.0f;"),
            (_GRID + "front_wide.py", "= 7.0f * (at(7) + at(11));", "= 0.0f * at(7);"),
        ],
    ),
    "bounds without pads": (
        _BOXES,
        "between",
        [
            *(("exact/faces.py", f"0x1p-20f * (1.0f + fabsf({x}))", "0.0f") for x in _BOUNDS),
            *((_GRID + "front_wide.py", f"0x1p-20f * (1.0f + size_of({x}))", "0.0f") for x in _BOUNDS),
        ],
    ),
    "depths without pads, of triangles and boxes": (
        _BOXES,
        "corners",
        [
            ("exact/faces.py", "nearest + 0x1p-18f * (1.0f + fabsf(nearest))", "nearest"),
            (_GRID + "front_wide.py", "near + 0x1p-18f * (1.0f + size_of(near))", "near"),
            (_GRID + "packing.py", "low[2] - 0.5 * _PAD * wp.abs(low[2])", "low[2]"),
            (_GRID + "packing_wide.py", "bound[4] - 0x1p-21f * fabsf(bound[4])", "bound[4]"),
        ],
    ),
    "faces told apart without a margin": (
        _BOXES,
        "between",
        [
            ("exact/faces.py", " - 0x1p-20f * size;", ";"),
            (_GRID + "front_wide.py", " - 0x1p-20f * reach;", ";"),
        ],
    ),
    "corners projected wherever they are": (
        _BOXES,
        "inside-0",
        [
            ("exact/faces.py", "if (!(front > 0x1p-18f * size))", "if (false)"),
            (_GRID + "front_wide.py", "bounded = bits(in_front);", "bounded = 0xFFFF;"),
        ],
    ),
    "covered by the edges alone": (
        _BOXES,
        "sun-0",
        [
            (_GRID + "binning.py", "covered = all && g - h + s.pt * t1 > plane;", "covered = all;"),
            (_GRID + "tile_test.py", f" & {_COVERED}", ""),
        ],
    ),
    "covered without pads": (
        _BOXES,
        "beside or vast",
        [
            (_GRID + "binning.py", "all = all && c - r > edge;", "all = all && c - r > 0.0f;"),
            *((_GRID + "tile_test.py", f"(c{k} - r{k} > edge)", f"(c{k} - r{k} > 0.0f)") for k in range(3)),
            (_GRID + "binning.py", "g - h + s.pt * t1 > plane;", "g - h + s.pt * t1 > 0.0f;"),
            (_GRID + "tile_test.py", _COVERED, _COVERED.replace("plane", "0.0f")),
        ],
    ),
    "pads that do not grow with the depth": (
        _BOXES,
        "near",
        [
            (
                _GRID + "binning.py",
                "6.0f + 2.001f * (fabsf(t0) > fabsf(t1) ? fabsf(t0) : fabsf(t1))",
                "6.0f",
            ),
            (_GRID + "tile_test.py", "6.0f + 2.001f * larger(size_of(t0), size_of(t1))", "6.0f"),
        ],
    ),
    "covered where the nearest ray is": (
        _BOXES,
        "sun-0",
        [
            (_GRID + "binning.py", "g - h + s.pt * t1 > plane;", "g - h + s.pt * t0 > plane;"),
            (_GRID + "tile_test.py", _COVERED, _COVERED.replace("t1", "t0")),
        ],
    ),
    "columns looked up by their middles": (
        _BOXES,
        "sun-0",
        [
            (_GRID + "tiles.py", "tiles.columns[box] - tiles.columns[box + 32]", "tiles.columns[box]"),
            (_GRID + "tiles.py", "tiles.columns[box] + tiles.columns[box + 32]", "tiles.columns[box]"),
        ],
    ),
}


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compiled kernels: what a safeguard is not part of is compiled once."""
    return tmp_path_factory.mktemp("kernels")


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    tests, some, changes = _MUTANTS[mutant]
    for folder in ("shadow_tracer", "test"):
        shutil.copytree(_ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(_ROOT / "pyproject.toml", tmp_path)
    for name, there, instead in changes:
        path = tmp_path / _GPU / name
        code = path.read_text(encoding="utf-8")
        assert code.count(there) == 1, f"the safeguard has moved from {name}: update this test"
        path.write_text(code.replace(there, instead), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"test/gpu/accelerators/light_grid/{tests}"]
        + ["-k", f"({some}) and not decide"],
        cwd=tmp_path,
        env={
            **{name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
            "WARP_CACHE_PATH": str(kernels),
            "SHADOW_TRACER_TEST_DEVICES": "cpu",
        },
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
    assert done.returncode == 1 and "AssertionError" in done.stdout, done.stdout + done.stderr
    scalar = ["packed_scalar" in line for line in failed]
    if tests != _CANDIDATES:  # which only the wide form has
        assert any(scalar) and not all(scalar), f"one of the forms does not see it: {failed}"
