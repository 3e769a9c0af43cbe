# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of kernels."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def machine_code(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Module below shadow_tracer.gpu -> file of its sm_90 machine code, made once for all tests: it takes seconds."""
    # Here and not above: tests that take a safeguard out run in copies of the package and the tests alone.
    from benchmark import kernel_resources

    made: dict[str, Path] = {}

    def code(module: str) -> Path:
        if module not in made:
            try:
                made[module] = kernel_resources.compile_module(module, tmp_path_factory.mktemp("cuda") / module)
            except kernel_resources.NoCompiler as error:
                pytest.skip(str(error))
        return made[module]

    return code


@pytest.fixture(scope="session")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compiled kernels of all copies of the package, for all processes of a run: what a safeguard is not part of is
    compiled once."""
    base = tmp_path_factory.getbasetemp()
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "kernels"
