# SPDX-License-Identifier: Apache-2.0
"""Copies of the package with a safeguard taken out, and the tests that must fail there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]

Change = tuple[str, str, str]  # a file below shadow_tracer/gpu, what stands there, and what is to stand there instead


def failing_tests(
    changes: Sequence[Change], tests: str, some: str, folder: Path, kernels: Path, first: bool = False
) -> list[str]:
    """The lines ``FAILED ...`` of tests in a copy that has been changed; some of them must fail by an assertion.

    Args:
        tests: a file below ``test/gpu``.
        some: which of them, as pytest's option -k takes it.
        folder: an empty one for the copy.
        kernels: a cache of kernels for several copies: what has not changed is compiled once.
        first: the first one that fails is enough.
    """
    for name in ("shadow_tracer", "test", "benchmark"):
        shutil.copytree(_ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(_ROOT / "pyproject.toml", folder)
    for name, there, instead in changes:
        path = folder / "shadow_tracer" / "gpu" / name
        code = path.read_text(encoding="utf-8")
        assert code.count(there) == 1, f"the safeguard has moved from {name}: update this test"
        path.write_text(code.replace(there, instead), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"test/gpu/{tests}", "-k", some]
        + (["-x"] if first else []),
        cwd=folder,
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
    assert done.returncode == 1 and "AssertionError" in done.stdout, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
