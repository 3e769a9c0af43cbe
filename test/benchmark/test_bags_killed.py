# SPDX-License-Identifier: Apache-2.0
"""Bags whose processes are killed at random moments have the bytes of those that nobody disturbed."""

from __future__ import annotations

import bags_killed
import pytest


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", "dask"])
def test_a_few_kills(engine: str, capsys: pytest.CaptureFixture[str]) -> None:
    if engine == "dask":
        pytest.importorskip("distributed")
    arguments = ["--engine", engine, "--kills", "2", "--frames", "1", "--longest", "4", "--mesh-megabytes", "0.01"]
    assert bags_killed.main([*arguments, "--seed", "3"]) == 0
    assert "the bytes are the same" in capsys.readouterr().out
