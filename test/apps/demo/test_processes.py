# SPDX-License-Identifier: Apache-2.0
"""Children of the demo end with it, whenever it is interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from shadow_tracer.apps.demo import processes

_SLEEPER = "import time; print('up', flush=True); time.sleep(600)"


@pytest.fixture
def sleeper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of a module that does nothing for ten minutes; and what a demo changes in the environment is put back."""
    (tmp_path / "sleeper.py").write_text(_SLEEPER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.setenv(name, os.environ.get(name, "1"))
    return "sleeper"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_a_child_is_begun(
    sleeper: str, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The signal comes when the child is there and nobody has noted it: it is interrupted then, and the child ends."""
    began: list[subprocess.Popen[bytes]] = []
    original = subprocess.Popen

    def begin(*args: Any, **kwargs: Any) -> subprocess.Popen[bytes]:
        began.append(original(*args, **kwargs))
        os.kill(os.getpid(), number)
        return began[0]

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(processes.subprocess, "Popen", begin)
    previous = signal.signal(number, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt), processes.Processes() as children:
            children.start("sleeper", sleeper)
        assert signal.getsignal(number) is interrupt
    finally:
        signal.signal(number, previous)
    assert began[0].poll() is not None
    assert not children.folder.exists()


def test_a_second_interrupt_waits_until_all_children_have_ended(sleeper: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stop = processes.Processes.stop

    def interrupted(self: processes.Processes) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        stop(self)

    monkeypatch.setattr(processes.Processes, "stop", interrupted)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), processes.Processes() as children:
            children.start("sleeper", sleeper)
    finally:
        signal.signal(signal.SIGINT, previous)
    assert children.exit_code("sleeper") is not None
    assert not children.folder.exists()


@pytest.mark.parametrize("after", [1, 3])
def test_a_signal_while_handlers_change_leaves_them_as_they_were(after: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that comes when the other's handler has been changed, or put back, already."""

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    numbers = (signal.SIGINT, signal.SIGTERM)
    previous = [signal.signal(number, interrupt) for number in numbers]
    original, calls = signal.signal, [0]

    def changed(number: signal.Signals, handler: Any) -> Any:
        found = original(number, handler)
        calls[0] += 1
        if calls[0] == after:
            os.kill(os.getpid(), signal.SIGTERM)
        return found

    try:
        with monkeypatch.context() as patch:
            patch.setattr(processes.signal, "signal", changed)
            with pytest.raises(KeyboardInterrupt), processes._signals_held_back():
                pass
        assert [signal.getsignal(number) for number in numbers] == [interrupt, interrupt]
    finally:
        for number, handler in zip(numbers, previous, strict=True):
            signal.signal(number, handler)


def test_a_child_does_not_outlive_a_parent_that_was_killed(sleeper: str, tmp_path: Path) -> None:
    """It has no time to end anybody."""
    program = (
        "import os, signal, time\n"
        "from shadow_tracer.apps.demo.processes import Processes\n"
        "with Processes() as children:\n"
        "    children.start('sleeper', 'sleeper', on_line=lambda line: os.kill(os.getpid(), signal.SIGKILL))\n"
        "    print(children._children['sleeper'].pid, children.folder, flush=True)\n"
        "    time.sleep(60)\n"
    )
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[3])])
    environment = {**os.environ, "PYTHONPATH": path, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, stdout=subprocess.PIPE, timeout=60)
    assert done.returncode == -signal.SIGKILL
    child = int(done.stdout.split()[0])
    end = time.monotonic() + 30
    while not _has_ended(child):
        assert time.monotonic() < end, "still running"
        time.sleep(0.01)


def _has_ended(pid: int) -> bool:
    """Gone, or a zombie: nobody but init waits for it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
