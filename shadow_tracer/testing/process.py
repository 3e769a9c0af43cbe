# SPDX-License-Identifier: Apache-2.0
"""The node as a separate process, which ends with whoever started it."""

from __future__ import annotations

import ctypes
import os
import signal
import site
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer.testing.isolation import isolated

# On top of the node's defaults, under what a test gives: made in a moment, on every machine, and it speaks often.
DEFAULTS: dict[str, Any] = {
    "device": "cpu",
    "bounds.max_triangles": 100_000,
    "bounds.max_rays": 640 * 480,
    "bounds.queue_capacity": 100_000,
    "diagnostics_period": 0.02,
}
_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)
_LAST_WORDS = 15  # lines of a node that are quoted
_libc = ctypes.CDLL(None)


class NotInTime(AssertionError):
    """What was waited for did not come; the message says what that was, and what came last."""


class NodeProcess:
    """The program ``shadow_node`` as a separate process, in the domain of :func:`isolated`. Use as a context manager.

    Args:
        parameters: name -> value, on top of :data:`DEFAULTS`.
        arguments: further ROS arguments, such as ``["-r", "__ns:=/front"]``.
        environment: further environment variables.
        command: what Python is to run.
        domain: as for :func:`isolated`.

    Attributes:
        out: lines it has written to stdout so far, err: to stderr.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any] | None = None,
        *,
        arguments: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        command: Sequence[str] = ("-m", "shadow_tracer.ros"),
        domain: int | None = None,
    ) -> None:
        values = {**DEFAULTS, **(parameters or {})}
        flags = [part for name, value in values.items() for part in ("-p", f"{name}:={_yaml(value)}")]
        path = os.environ.get("PYTHONPATH", "")
        root = str(Path(__file__).resolve().parents[2])
        if root not in site.getsitepackages():  # a source tree, which the child might not find
            path = os.pathsep.join(filter(None, (root, path)))
        self.out: list[str] = []
        self.err: list[str] = []
        self._asked = False
        self._left = ExitStack()
        self._left.enter_context(isolated(domain))
        try:
            self._process = subprocess.Popen(
                [sys.executable, *command, "--ros-args", *flags, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                preexec_fn=_in_the_child,
                env={**os.environ, "PYTHONPATH": path, **(environment or {})},
            )
        except BaseException:
            self._left.close()
            raise
        self._readers = [
            threading.Thread(target=self._read, args=(stream, into), name="output of the node", daemon=True)
            for stream, into in ((self._process.stdout, self.out), (self._process.stderr, self.err))
        ]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream: Any, into: list[str]) -> None:
        with stream:
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

    @property
    def failed(self) -> bool:
        """True once the process has ended without a signal sent from here."""
        return not self._asked and not self.running

    def wait_for(self, text: str, timeout: float = 300.0) -> None:
        """Wait until a line of stdout contains the text; ``"Ready"`` is what a node says that traces.

        Raises:
            NotInTime: after ``timeout`` seconds, or when the process has ended without it.
        """
        deadline = time.monotonic() + timeout
        while not any(text in line for line in list(self.out)):
            if not self.running:
                for reader in self._readers:
                    reader.join(5.0)
                if any(text in line for line in self.out):
                    return
                raise NotInTime(f"no line with {text!r}: the node ended with {self._process.returncode}; {self.said()}")
            if time.monotonic() > deadline:
                raise NotInTime(f"not within {timeout:g} s: a line with {text!r}; {self.said()}")
            self._readers[0].join(0.02)

    def said(self) -> str:
        """The last lines that it has written."""
        lines = [*self.out[-_LAST_WORDS:], *self.err[-_LAST_WORDS:]]
        return "the node said last:\n" + "".join(lines) if lines else "the node said nothing"

    def stop(self, number: signal.Signals = signal.SIGINT, timeout: float = 30.0) -> tuple[int, str]:
        """Send a signal; returns the exit code and everything on stderr. Raises as :meth:`wait`."""
        self.send(number)
        return self.wait(timeout)

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._asked = True
        self._process.send_signal(number)

    def wait(self, timeout: float = 60.0) -> tuple[int, str]:
        """Wait for the end; returns the exit code and everything on stderr.

        Raises:
            NotInTime: it still runs after ``timeout`` seconds.
        """
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise NotInTime(f"not within {timeout:g} s: the end of the node; {self.said()}") from None
        for reader in self._readers:
            reader.join(5.0)
        return code, "".join(self.err)

    def close(self, patience: float = 10.0) -> None:
        """End the process if it still runs: politely, so that it leaves no shared memory, by force after ``patience``
        seconds."""
        try:
            if self.running:
                self.send(signal.SIGINT)
                try:
                    self._process.wait(patience)
                except subprocess.TimeoutExpired:
                    pass
        finally:
            if self.running:
                self._process.kill()
            self._process.wait()
            for reader in self._readers:
                reader.join(5.0)
            self._left.close()

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _in_the_child() -> None:
    """Before it runs. A shell without job control starts what runs in the background with SIGINT ignored, and children
    inherit that. SIGTERM comes when the thread that started the node has ended, say because its process was killed."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _libc.prctl(_PARENT_DEATH_SIGNAL, signal.SIGTERM)


def _yaml(value: Any) -> str:
    """A value as ``-p name:=`` takes it."""
    if isinstance(value, (bool, np.bool_)):
        return str(bool(value)).lower()
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, (float, np.floating)) and np.isfinite(value):
        return np.format_float_positional(value, trim="0")  # without exponent: 1e-05 is no number in YAML
    return str(value)
