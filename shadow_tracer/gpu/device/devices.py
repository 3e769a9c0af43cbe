# SPDX-License-Identifier: Apache-2.0
"""Starting Warp, and choosing a device."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp


def pick_device(name: str | None) -> Any:
    """The Warp device of that name; None is the first CUDA device, or the CPU if there is none.

    Raises:
        ValueError: no such device; the message lists those there are.
    """
    _start_quietly()
    known = [str(device) for device in wp.get_devices()]
    if name is None:
        name = "cuda:0" if "cuda:0" in known else "cpu"
    if name not in known:
        raise ValueError(f"device: expected one of {', '.join(known)}, or auto (None in Python), got {name!r}")
    return wp.get_device(name)


def _start_quietly() -> None:
    """Start Warp without its banner, its line per loaded module, and its warning about a machine without a GPU."""
    if wp.config.log_level != wp.LOG_INFO:  # the user has chosen, or we were here before
        wp.init()
        return
    wp.config.log_level = wp.LOG_ERROR
    try:
        if _has_cuda_driver():
            wp.init()
        else:
            with _silent_stderr():
                wp.init()
    finally:
        wp.config.log_level = wp.LOG_WARNING


def _has_cuda_driver() -> bool:
    for library in ("libcuda.so", "libcuda.so.1"):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return True
    return False


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Warp's native code prints that there is no CUDA driver straight to file descriptor 2; without a GPU that is no
    news."""
    sys.stderr.flush()
    saved = os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)
