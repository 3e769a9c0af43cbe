# SPDX-License-Identifier: Apache-2.0
"""The demo's child processes: a ROS domain of their own, logs in a temporary folder, and a sure end."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType

PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)
SEGMENT = 16 * 2**20
SHARED_MEMORY = Path("/dev/shm")
# Stock Fast DDS shares half a megabyte of memory per process: what a frame needs beyond that is dropped and repaired
# seconds later. Announcements are sent more often so that the processes find each other at once.
FAST_DDS_PROFILE = f"""<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>large_shared_memory</transport_id>
        <type>SHM</type>
        <segment_size>{SEGMENT}</segment_size>
      </transport_descriptor>
      <transport_descriptor>
        <transport_id>udp</transport_id>
        <type>UDPv4</type>
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="demo" is_default_profile="true">
      <rtps>
        <userTransports>
          <transport_id>large_shared_memory</transport_id>
          <transport_id>udp</transport_id>
        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
        <builtin>
          <discovery_config>
            <leaseAnnouncement><sec>0</sec><nanosec>200000000</nanosec></leaseAnnouncement>
          </discovery_config>
        </builtin>
      </rtps>
    </participant>
  </profiles>
</dds>
"""


class Processes:
    """Starts children and ends them all when left, however it is left.

    Attributes:
        folder: temporary folder for parameters and logs, removed at the end.
        domain: the ROS domain all of them and this process use.
    """

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="shadow_tracer_demo_"))
        self.domain = 1 + (os.getpid() * 31 + time.time_ns() // 1_000_000) % 101
        os.environ.update(
            ROS_DOMAIN_ID=str(self.domain),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            ROS_LOG_DIR=str(self.folder / "ros_log"),
        )
        if SHARED_MEMORY.is_dir() and shutil.disk_usage(SHARED_MEMORY).free > 4 * SEGMENT:
            profile = self.folder / "fast_dds.xml"
            profile.write_text(FAST_DDS_PROFILE, encoding="utf-8")
            os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._readers: list[threading.Thread] = []

    def __enter__(self) -> Processes:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with _signals_held_back():  # a second Ctrl-C must not leave children behind
            self.stop()
            shutil.rmtree(self.folder, ignore_errors=True)

    def start(self, name: str, module: str, *arguments: str, on_line: Callable[[str], None] | None = None) -> None:
        """Starts `python -m module arguments`; its output goes to a log file, or line by line to `on_line`."""
        log = self._log(name)
        # an interrupt between the child's beginning and our knowing of it would leave it behind
        with log.open("wb") as file, _signals_held_back():
            child = self._children[name] = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=file if on_line is None else subprocess.PIPE,
                stderr=file,
                preexec_fn=_die_with_parent if sys.platform == "linux" else None,
            )
        if on_line is not None:
            reader = threading.Thread(target=_read_lines, args=(child, on_line), name=f"{name} output", daemon=True)
            reader.start()
            self._readers.append(reader)

    def exit_code(self, name: str) -> int | None:
        """Exit code of a child, None while it runs."""
        return self._children[name].poll()

    def tail(self, name: str, lines: int = 15) -> str:
        """The last lines a child logged."""
        log = self._log(name)
        return "\n".join(log.read_text(errors="replace").splitlines()[-lines:]) if log.is_file() else ""

    def stop(self, patience: float = 5.0) -> None:
        """Asks all children to end, and kills those that have not after `patience` seconds."""
        for child in self._children.values():
            if child.poll() is None:
                child.send_signal(signal.SIGINT)
        end = time.monotonic() + patience
        for child in self._children.values():
            try:
                child.wait(max(0.1, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        for reader in self._readers:
            reader.join(timeout=1.0)
        for child in self._children.values():
            if child.stdout is not None:
                child.stdout.close()

    def _log(self, name: str) -> Path:
        return self.folder / f"{name}.log"


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """SIGINT and SIGTERM that come inside take effect at the end; not in other threads, which Python sends none."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    try:
        with ExitStack() as restored:  # all of them, even if one comes in between
            for number in numbers:
                restored.callback(signal.signal, number, signal.getsignal(number) or signal.SIG_DFL)
            for number in numbers:
                signal.signal(number, lambda which, _: came.append(which))
            yield
    finally:
        if came:
            signal.raise_signal(came[0])


def _read_lines(child: subprocess.Popen[bytes], on_line: Callable[[str], None]) -> None:
    if child.stdout is not None:
        for line in child.stdout:
            on_line(line.decode(errors="replace").strip())


def _die_with_parent() -> None:
    """In the child, before it runs: SIGTERM when this process ends without having stopped it, say by SIGKILL."""
    ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, signal.SIGTERM)
