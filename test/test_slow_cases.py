# SPDX-License-Identifier: Apache-2.0
"""Who wants the mark ``slow``: named by what is used every time, not by chance."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import slow_cases

_CASES = """
import os, time
import pytest

def _use(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

def test_quick():
    pass

def test_waits():
    time.sleep(0.3)

def test_uses():
    _use(0.3)

def test_once():
    if not os.environ.get("SHADOW_TRACER_TEST_SLOW"):
        _use(0.3)

@pytest.mark.slow
def test_marked():
    _use(0.3)
"""

_CONFTEST = """
import sys
sys.path.insert(0, {test!r})
import slow_cases
slow_cases.SECONDS = 0.1
slow_cases._YARDSTICK = float("inf")  # this machine is not a slow one, whatever else it does

def pytest_addoption(parser):
    parser.addoption("--find-slow", action="store_true")

def pytest_configure(config):
    config.addinivalue_line("markers", "slow: ")
    config.pluginmanager.register(slow_cases.Meter(config), "slow cases")
"""


@pytest.mark.slow
@pytest.mark.parametrize("processes", [0, 1])
def test_a_case_that_takes_long_every_time_is_named(tmp_path: Path, processes: int) -> None:
    """Not who waits, not who took long once, not who is marked; alone or under xdist."""
    (tmp_path / "test_cases.py").write_text(_CASES)
    (tmp_path / "conftest.py").write_text(_CONFTEST.format(test=str(Path(__file__).parent)))
    command = [sys.executable, "-m", "pytest", "-q", "-n", str(processes), "-p", "no:cacheprovider", "test_cases.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    named = [line.split()[0] for line in done.stdout.splitlines() if "it wants the mark slow" in line]
    assert named == ["test_cases.py::test_uses"], done.stdout + done.stderr
    assert done.returncode == pytest.ExitCode.TESTS_FAILED and "5 passed" in done.stdout


def test_a_slow_machine_and_a_busy_moment_name_nobody() -> None:
    measured: list[list[str]] = []

    def measure(cases: list[str], stick: float = slow_cases._YARDSTICK, seconds: float = 9.0) -> Any:
        measured.append(cases)
        return stick, dict.fromkeys(cases, seconds)

    long = {"a": 8.0, "b": 0.5, "c": 1.9}
    assert slow_cases.confirmed(long, measure) == {"a": 8.0} and measured == [["a"], ["a"]]
    assert slow_cases.confirmed(long, lambda cases: measure(cases, 5 * slow_cases._YARDSTICK)) == {}, "all is slower"
    assert slow_cases.confirmed(long, lambda cases: measure(cases, seconds=1.0)) == {}, "alone it is quick enough"
    assert slow_cases.confirmed(long, lambda cases: (slow_cases._YARDSTICK, {})) == {}, "or it does not run again"
    assert slow_cases.confirmed({"b": 0.5}, lambda cases: 1 // 0) == {}, "nobody is measured again without need"
