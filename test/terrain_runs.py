# SPDX-License-Identifier: Apache-2.0
"""Tiles of a terrain that go wrong, for tests: workers import this."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from shadow_tracer.apps.terrain.run import Job, answer


def perilous(job: Job) -> bool:
    """Does a tile; the third one kills its process at the first try."""
    mark = Path(os.environ["SHADOW_TRACER_TEST_MARK"])
    if job.number == 2 and not mark.exists():
        mark.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return answer(job)
