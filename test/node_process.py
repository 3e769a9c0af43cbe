# SPDX-License-Identifier: Apache-2.0
"""The programs of the package as processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import shadow_tracer

# Small buffers: a node of a test is made in milliseconds.
SMALL = {
    "device": "cpu",
    "bounds.max_triangles": 4096,
    "bounds.max_rays": 128 * 96,
    "bounds.queue_capacity": 16384,
    "diagnostics_period": 0.1,
}


def _hears_interrupts() -> None:
    """A shell without job control starts what runs in the background with SIGINT ignored, and children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class NodeProcess:
    """The program ``shadow_node`` as a process of its own. Use as a context manager.

    Args:
        parameters: overrides, on top of :data:`SMALL`.
        environment: further environment variables.
        command: what Python is to run.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any] | None = None,
        *,
        arguments: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        command: Sequence[str] = ("-m", "shadow_tracer.ros"),
    ) -> None:
        values = {**SMALL, **(parameters or {})}
        flags = [part for name, value in values.items() for part in ("-p", f"{name}:={_yaml(value)}")]
        root = str(Path(shadow_tracer.__file__).parents[1])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH", ""))))
        self._process = subprocess.Popen(
            [sys.executable, *command, "--ros-args", *flags, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=_hears_interrupts,
            env={**os.environ, "PYTHONPATH": path, **(environment or {})},
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=(stream, into), daemon=True)
            for stream, into in ((self._process.stdout, self.out), (self._process.stderr, self.err))
        ]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream: Any, into: list[str]) -> None:
        for line in stream:
            into.append(line)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """True until the process has ended."""
        return self._process.poll() is None

    def wait_for(self, text: str, timeout: float = 120.0) -> None:
        """Wait until a line of stdout contains the text."""
        deadline = time.monotonic() + timeout
        while not any(text in line for line in list(self.out)):
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise AssertionError(f"no line with {text!r}: {self.out} {self.err}")
            self._readers[0].join(0.02)

    def stop(self, number: signal.Signals, timeout: float = 30.0) -> tuple[int, str]:
        """Send a signal; returns the exit code and everything on stderr."""
        self.send(number)
        return self.wait(timeout)

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def wait(self, timeout: float = 60.0) -> tuple[int, str]:
        """Wait for the end; returns the exit code and everything on stderr."""
        code = self._process.wait(timeout)
        for reader in self._readers:
            reader.join(5.0)
        return code, "".join(self.err)

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
