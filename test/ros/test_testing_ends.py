# SPDX-License-Identifier: Apache-2.0
"""The harness for users: a private domain, and nothing left of nodes, processes, threads and shared memory."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest
from harness import SMALL

from shadow_tracer.testing import Harness, NodeProcess, NotInTime, isolated, isolation, wall

ROOT = Path(__file__).resolve().parents[2]
SHARED_MEMORY = Path("/dev/shm")


def child(code: str) -> subprocess.Popen[str]:
    """A Python with this package that runs the code; its stdout is read line by line."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )


def gone(pid: int) -> bool:
    """Whether a process has ended; one that nobody has waited for counts as ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def wait_until_gone(pid: int) -> None:
    deadline = time.monotonic() + 20.0
    while not gone(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert gone(pid)


def segments(pid: int) -> set[str]:
    """Names of the shared memory that a process has mapped."""
    return set(re.findall(rf"{SHARED_MEMORY}/(\S+)", Path(f"/proc/{pid}/maps").read_text()))


def test_a_domain_is_private_and_the_environment_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "200")
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "0")  # stronger than the range
    monkeypatch.delenv("ROS_LOG_DIR", raising=False)
    before = dict(os.environ)
    with isolated() as domain:
        log = Path(os.environ["ROS_LOG_DIR"])
        assert domain in isolation.DOMAINS and os.environ["ROS_DOMAIN_ID"] == str(domain) and log.is_dir()
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST" and "ROS_LOCALHOST_ONLY" not in os.environ
        with isolated() as inner, isolated(domain) as same:
            assert inner == same == domain
        assert os.environ["ROS_DOMAIN_ID"] == str(domain) and log.is_dir()
        with pytest.raises(ValueError, match=f"domain: expected {domain}, which this process is in already, got"):
            isolated(domain + 1).__enter__()
    assert dict(os.environ) == before and not log.exists()


@pytest.mark.parametrize("domain", [-1, 233, True, "5", 1.0])
def test_what_is_no_domain_is_refused(domain: object) -> None:
    with pytest.raises(ValueError, match="domain: expected an integer from 0 to 232, or None, got"):
        isolated(domain).__enter__()  # type: ignore[arg-type]


def test_processes_hold_different_domains_until_they_end(monkeypatch: pytest.MonkeyPatch) -> None:
    code = f"""
        import os, time
        os.getpid = lambda: {os.getpid()}  # it would like the same domain
        from shadow_tracer.testing import isolated
        with isolated() as domain:
            print(domain, flush=True)
            time.sleep(600)
    """
    other = child(code)
    try:
        assert other.stdout is not None
        taken = int(other.stdout.readline())
        monkeypatch.setattr(isolation, "DOMAINS", range(taken, taken + 2))
        for _ in range(2):
            with isolated() as mine:
                assert mine == taken + 1
        monkeypatch.setattr(isolation, "DOMAINS", range(taken, taken + 1))
        with pytest.raises(RuntimeError, match="domain: all from .* are taken"):
            isolated().__enter__()
    finally:
        other.kill()
        other.communicate()
    with isolated() as mine:
        assert mine == taken


def test_a_harness_in_this_process_leaves_nothing() -> None:
    before = set(os.listdir(SHARED_MEMORY))
    with Harness(SMALL) as harness:
        harness.trace(wall())
        context = harness.context
        made = segments(os.getpid()) - before
    assert not context.ok() and made and not made & set(os.listdir(SHARED_MEMORY))
    # The workers of a tracer serve all tracers of the process.
    left = [thread.name for thread in threading.enumerate() if thread.name not in ("MainThread", "shadow_tracer")]
    assert "tracer" not in left, left


def test_a_node_that_cannot_start_leaves_nothing() -> None:
    before = os.environ.get("ROS_LOG_DIR")
    with pytest.raises(Exception, match="pose_source: expected string"):
        Harness({**SMALL, "pose_source": "gps"})
    assert os.environ.get("ROS_LOG_DIR") == before and isolation._current is None
    with pytest.raises(NotInTime, match="'Ready': the node ended with 1; the node said last:\n.*pose_source"):
        Harness({**SMALL, "pose_source": "gps"}, process=True)
    assert os.environ.get("ROS_LOG_DIR") == before and isolation._current is None


@pytest.mark.slow
def test_a_node_in_another_process_ends_with_the_harness_also_when_a_test_fails() -> None:
    before = set(os.listdir(SHARED_MEMORY))
    with pytest.raises(ZeroDivisionError), Harness(SMALL, process=True) as harness:
        assert harness.process is not None
        pid = harness.process.pid
        made = segments(pid) - before
        raise ZeroDivisionError
    assert gone(pid) and made and not made & set(os.listdir(SHARED_MEMORY))
    assert harness.process.wait() == (0, "") and isolation._current is None


@pytest.mark.slow
def test_a_node_that_dies_is_not_waited_for() -> None:
    with Harness(SMALL, process=True) as harness:
        assert harness.process is not None
        os.kill(harness.process.pid, signal.SIGKILL)
        begin = time.monotonic()
        with pytest.raises(NotInTime, match=r"the node ended before a mask .*; the node said last:\n[\s\S]*Ready"):
            harness.trace(wall())
        assert time.monotonic() - begin < 10.0


STUBBORN = ("-c", "import signal, time\nsignal.signal(2, signal.SIG_IGN)\nprint('up', flush=True)\ntime.sleep(600)")


def test_a_stubborn_process_is_killed() -> None:
    process = NodeProcess(command=STUBBORN)
    process.wait_for("up")
    with pytest.raises(NotInTime, match="not within 0.05 s: a line with 'Ready'; the node said last:\nup"):
        process.wait_for("Ready", 0.05)
    with pytest.raises(NotInTime, match="not within 0.05 s: the end of the node"):
        process.stop(timeout=0.05)
    process.close(patience=0.05)
    assert gone(process.pid) and process.wait()[0] == -signal.SIGKILL
    assert not [thread for thread in threading.enumerate() if thread.name == "output of the node"]


def test_a_process_ends_with_a_test_that_is_killed() -> None:
    code = f"""
        import time
        from shadow_tracer.testing import NodeProcess
        process = NodeProcess(command={STUBBORN!r})
        process.wait_for("up")
        print(process.pid, flush=True)
        time.sleep(600)
    """
    test = child(code)
    assert test.stdout is not None
    pid = int(test.stdout.readline())
    test.kill()
    test.communicate()
    wait_until_gone(pid)
