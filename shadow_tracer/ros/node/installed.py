# SPDX-License-Identifier: Apache-2.0
"""Where the files lie that come with the package, as a message can name them. No ROS here."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_PACKAGE = "shadow_tracer"


def config_file(name: str) -> str:
    """Path of a file of the package's folder config: of the sources that run, of the environment, or of what
    ``AMENT_PREFIX_PATH`` names. Where there is none, the folder in words."""
    prefixes = [sys.prefix, *filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    shares = [Path(__file__).parents[3], *(Path(prefix, "share", _PACKAGE) for prefix in prefixes)]
    for share in shares:
        path = share / "config" / name
        if path.is_file() and (share / "package.xml").is_file():
            return str(path)
    return f"config/{name} of the package {_PACKAGE}"
