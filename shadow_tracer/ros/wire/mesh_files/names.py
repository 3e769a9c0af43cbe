# SPDX-License-Identifier: Apache-2.0
"""Where a file is: names as in URDF."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from urllib.parse import unquote, urlsplit

from shadow_tracer.ros.wire.parts import PartError

_INDEX = Path("share/ament_index/resource_index/packages")


def locate(where: str, field: str = "mesh.files") -> Path:
    """Absolute path of a file that is named as in :func:`load_mesh_file`. Raises PartError, which starts with the
    field, if it is not there."""
    scheme = re.match(r"([A-Za-z][A-Za-z0-9+.-]*)://", where)
    if scheme is None:
        path = Path(os.path.expanduser(where))
    elif scheme[1] == "package":
        path = _in_package(where, field)
    elif scheme[1] == "file" and urlsplit(where).netloc in ("", "localhost"):
        path = Path(unquote(urlsplit(where).path))
    else:
        raise PartError(f"{field}: expected a path, file:///... or package://..., got {where!r}")
    try:
        path = path.absolute()
        if not stat.S_ISREG(path.stat().st_mode):
            raise PartError(f"{field}: {path} is not a file")
    except (OSError, ValueError) as error:
        if isinstance(error, PartError):
            raise
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise PartError(f"{field}: cannot find {str(path)!r}: {reason}") from error
    return path


def _in_package(where: str, field: str) -> Path:
    name, _, rest = where.partition("://")[2].partition("/")
    if not name or not rest:
        raise PartError(f"{field}: expected package://<package>/<path>, got {where!r}")
    try:
        prefix = _package_prefix(name)
    except (LookupError, OSError, ValueError) as error:
        paths = os.environ.get("AMENT_PREFIX_PATH", "")
        raise PartError(
            f"{field}: there is no package {name!r} in AMENT_PREFIX_PATH, which is {paths!r}; source the setup file "
            "of its workspace before the node starts"
        ) from error
    return Path(prefix) / "share" / name / unquote(rest)


def _package_prefix(name: str) -> str:
    """Where a package is installed. Raises LookupError, OSError or ValueError."""
    try:
        from ament_index_python.packages import get_package_prefix
    except ImportError:
        pass
    else:
        return str(get_package_prefix(name))
    # The same without ROS.
    if re.fullmatch("[a-zA-Z0-9][a-zA-Z0-9_-]+", name, re.ASCII) is None:
        raise ValueError(f"{name!r} is not a valid package name")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (Path(prefix) / _INDEX / name).is_file():
            return prefix
    raise LookupError(name)
