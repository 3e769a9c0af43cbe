# SPDX-License-Identifier: Apache-2.0
"""Who takes over a second carries the mark ``slow``: so the inner loop, ``make quick``, stays one.

Seconds are those of the processor that a case and its child processes use, not of the clock, which runs on while others
work. Even these grow on a busy machine; so a case that took too many is run again in a separate process, up to
``_AGAIN`` times, and judged by the least, against a piece of work of known size that is measured beside it. Only who
takes twice the allowance every time is named. Waiting costs no processor time: a case that waits for over a second is
marked by whoever writes it.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

SECONDS = 1.0  # without the mark
_TIMES = 2.0  # the allowance that makes it sure
_AGAIN = 2
_YARDSTICK = 0.08  # seconds of `_yardstick` on the machine on which the marks were set

_FILE = "SHADOW_TRACER_TEST_SLOW"  # where a process that measures again writes what it found

Seconds = dict[str, float]
SLOW = pytest.StashKey[Seconds]()


def used() -> float:
    """Seconds of the processor that this process and those of its children that have ended have used."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


def _yardstick() -> float:
    """Seconds for a known piece of work, the least of three."""
    least = float("inf")
    for _ in range(3):
        begin, number = used(), 1
        for _ in range(1_000_000):
            number = number * 48271 % 2147483647
        least = min(least, used() - begin)
    return least


class Meter:
    """Plugin: notes what each case without the mark uses, in the process that runs it, and collects it where the
    results of all come together."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._begun: dict[str, float] = {}
        self.seconds: Seconds = {}

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._begun[nodeid] = used()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        if item.get_closest_marker("slow") is None:
            item.user_properties.append(("seconds", used() - self._begun.pop(item.nodeid)))
        return (yield)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            noted = dict(report.user_properties).get("seconds")
            if noted is not None:
                self.seconds[report.nodeid] = float(str(noted))

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        config = self._config
        if hasattr(config, "workerinput"):
            return
        file = os.environ.get(_FILE)
        if file:  # we are one of those that measure again
            Path(file).write_text(json.dumps({"yardstick": _yardstick(), "cases": self.seconds}))
            return
        config.stash[SLOW] = confirmed(self.seconds, lambda cases: _measure(cases, config))
        if config.stash[SLOW] and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for case, seconds in sorted(self._config.stash.get(SLOW, {}).items()):
            line = f"{case} takes {seconds:.1f} s of processor time: over {SECONDS:g} s, so it wants the mark slow"
            terminalreporter.write_line(line, red=True)


def confirmed(seconds: Seconds, measure: Callable[[list[str]], tuple[float, Seconds]]) -> Seconds:
    """Those of the cases that are over the allowance every time.

    Args:
        measure: seconds for the yardstick, and for each of the cases, measured once more.
    """
    found = _over(seconds)
    for _ in range(_AGAIN):
        if found:
            yardstick, again = measure(list(found))
            slowness = max(1.0, yardstick / _YARDSTICK)
            found = _over({case: min(first, again.get(case, 0.0) / slowness) for case, first in found.items()})
    return found


def _over(seconds: Seconds) -> Seconds:
    return {case: value for case, value in seconds.items() if value > _TIMES * SECONDS}


def _measure(cases: list[str], config: pytest.Config) -> tuple[float, Seconds]:
    """Run cases again, in a separate process."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "seconds.json"
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", "--find-slow", *cases]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
        subprocess.run(
            command, cwd=config.rootpath, env={**environment, _FILE: str(file)}, capture_output=True, check=False
        )
        found = json.loads(file.read_text()) if file.exists() else {"yardstick": _YARDSTICK, "cases": {}}
    return found["yardstick"], found["cases"]
