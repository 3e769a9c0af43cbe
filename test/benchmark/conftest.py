# SPDX-License-Identifier: Apache-2.0
"""The programs of benchmark/ import each other by their bare names, as they do when they are run."""

from __future__ import annotations

import sys
from pathlib import Path

_PROGRAMS = str(Path(__file__).resolve().parents[2] / "benchmark")
if _PROGRAMS not in sys.path:
    sys.path.append(_PROGRAMS)
