# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that nobody else on this machine tests in, and an environment that keeps ROS on this machine."""

from __future__ import annotations

import os
import shutil
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

DOMAINS = range(1, 102)  # what every operating system has ports for
# These reach beyond the domain or this machine, whatever ROS_AUTOMATIC_DISCOVERY_RANGE says.
_IN_THE_WAY = ("ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")


@dataclass
class _Isolation:
    """What is in force in this process, and what to put back."""

    domain: int
    claim: socket.socket | None
    folder: str
    before: dict[str, str | None]
    users: int = 0


_lock = threading.Lock()
_current: _Isolation | None = None


@contextmanager
def isolated(domain: int | None = None) -> Iterator[int]:
    """Keep what ROS does in this process and in its children within a private domain on this machine.

    The environment has ``ROS_DOMAIN_ID``, ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` and a temporary ``ROS_LOG_DIR``
    inside, and is what it was afterwards. Contexts made before keep their domain. Inside another ``isolated`` it is the
    same domain. :class:`Harness` and :class:`NodeProcess` enter it themselves.

    Args:
        domain: join this one, 0 to 232, as another process chose it; None for one that no other process has chosen.

    Yields:
        The domain.

    Raises:
        ValueError: ``domain`` is no domain, or not the one that this process is in already.
        RuntimeError: all domains are taken.
    """
    if domain is not None and (isinstance(domain, bool) or not isinstance(domain, int) or not 0 <= domain <= 232):
        raise ValueError(f"domain: expected an integer from 0 to 232, or None, got {domain!r}")
    number = _enter(domain)
    try:
        yield number
    finally:
        _leave()


def _enter(domain: int | None) -> int:
    global _current
    with _lock:
        if _current is None:
            _current = _begin(domain)
        elif domain not in (None, _current.domain):
            raise ValueError(f"domain: expected {_current.domain}, which this process is in already, got {domain}")
        _current.users += 1
        return _current.domain


def _begin(domain: int | None) -> _Isolation:
    claim = None
    if domain is None:
        domain, claim = _claim()
    folder = tempfile.mkdtemp(prefix="shadow_tracer_ros_log_")
    names = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR", *_IN_THE_WAY)
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", ROS_LOG_DIR=folder)
    for name in _IN_THE_WAY:
        os.environ.pop(name, None)
    return _Isolation(domain, claim, folder, before)


def _claim() -> tuple[int, socket.socket]:
    """A domain and what holds it: an abstract socket, which the kernel frees however this process ends."""
    first = os.getpid() % len(DOMAINS)
    for domain in (*DOMAINS[first:], *DOMAINS[:first]):
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            claim.bind(f"\0shadow_tracer.testing/ros_domain/{domain}")
            return domain, claim
        except OSError:
            claim.close()
    raise RuntimeError(f"domain: all from {DOMAINS[0]} to {DOMAINS[-1]} are taken by other processes that test")


def _leave() -> None:
    global _current
    with _lock:
        assert _current is not None
        _current.users -= 1
        if _current.users:
            return
        for name, value in _current.before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if _current.claim is not None:
            _current.claim.close()
        shutil.rmtree(_current.folder, ignore_errors=True)
        _current = None
