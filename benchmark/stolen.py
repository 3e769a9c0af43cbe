# SPDX-License-Identifier: Apache-2.0
"""How long the processors of a virtual machine were taken away by others, so that such a frame need not count."""

from __future__ import annotations

import os
from pathlib import Path

_STAT = Path("/proc/stat")
# Behind "cpu": user, nice, system, idle, iowait, irq, softirq, steal, all in ticks.
_STEAL = 8


def stolen() -> float:
    """Seconds that this machine's processors, all together, have lost to other machines; 0 where nobody says."""
    try:
        fields = _STAT.read_text(encoding="ascii").split("\n", 1)[0].split()
        return int(fields[_STEAL]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0
