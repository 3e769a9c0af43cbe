# SPDX-License-Identifier: Apache-2.0
"""The two forms in which kernels are written: for few threads with vector registers, and for very many threads.

The CPU runs Warp's tasks one after the other: there a task takes a whole block of rays or triangles, 16 lanes at a
time (the *wide* form). CUDA runs each task in its own thread: there a task takes one ray, tile or triangle (the *CUDA
form*). Both give the same bits. Which one is used is decided here and nowhere else; decisions about memory, streams
and recordings look at the device itself.

``SHADOW_TRACER_FORM=cuda`` makes the CPU take the CUDA form, so that tests run it without a GPU. It is slower.
"""

from __future__ import annotations

import os
from typing import Any

VARIABLE = "SHADOW_TRACER_FORM"
# Tasks of the CUDA form that share a list of unknown length, where the CPU runs them: one after the other, so more of
# them only take time.
_TASKS_ON_A_CPU = 256


def _cuda_form_everywhere() -> bool:
    value = os.environ.get(VARIABLE, "")
    if value not in ("", "cuda"):
        raise ValueError(f"{VARIABLE}: expected cuda or nothing, got {value!r}")
    return value == "cuda"


_CUDA_FORM_EVERYWHERE = _cuda_form_everywhere()


def wide(device: Any) -> bool:
    """Whether kernels on ``device`` take the wide form."""
    return bool(device.is_cpu) and not _CUDA_FORM_EVERYWHERE


def tasks(device: Any, most: int) -> int:
    """How many tasks share work whose amount only the device knows: one in the wide form, ``most`` on CUDA."""
    if wide(device):
        return 1
    return min(most, _TASKS_ON_A_CPU) if device.is_cpu else most
