# SPDX-License-Identifier: Apache-2.0
"""The two forms in which kernels are written: for few threads with vector registers, and for very many threads.

The CPU runs Warp's tasks one after the other: there a task takes a whole block of rays or triangles, 16 lanes at a
time (the *wide* form). CUDA runs each task in its own thread: there a task takes one ray, tile or triangle (the *CUDA
form*). Both give the same bits. Which one is used is decided here and nowhere else; decisions about memory, streams
and recordings look at the device itself.

``SHADOW_TRACER_FORM=cuda`` makes the CPU take the CUDA form in the whole process, :func:`cuda_form` for a while, so
that tests run it without a GPU. It is slower.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

VARIABLE = "SHADOW_TRACER_FORM"
# Tasks of the CUDA form that share a list of unknown length, where the CPU runs them: one after the other, so more of
# them only take time.
_TASKS_ON_A_CPU = 256


def _asked_for() -> bool:
    value = os.environ.get(VARIABLE, "")
    if value not in ("", "cuda"):
        raise ValueError(f"{VARIABLE}: expected cuda or nothing, got {value!r}")
    return value == "cuda"


_cuda_form_everywhere = _asked_for()


@contextmanager
def cuda_form() -> Iterator[None]:
    """As long as this is open the CPU takes the CUDA form, in all threads of the process. For tests.

    What a tracer or depth camera allocates goes by the form, and so does what it launches: one that was made in a form
    is to be used in that form alone.
    """
    global _cuda_form_everywhere
    before, _cuda_form_everywhere = _cuda_form_everywhere, True
    try:
        yield
    finally:
        _cuda_form_everywhere = before


def wide(device: Any) -> bool:
    """Whether kernels on ``device`` take the wide form."""
    return bool(device.is_cpu) and not _cuda_form_everywhere


def tasks(device: Any, most: int) -> int:
    """How many tasks share work whose amount only the device knows: one in the wide form, ``most`` on CUDA."""
    if wide(device):
        return 1
    return min(most, _TASKS_ON_A_CPU) if device.is_cpu else most
