# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of kernels."""

from __future__ import annotations

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


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compiled kernels: what a safeguard is not part of is compiled once."""
    return tmp_path_factory.mktemp("kernels")
