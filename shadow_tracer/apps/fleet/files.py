# SPDX-License-Identifier: Apache-2.0
"""Files that are whole or not there, and folders that only one run writes into."""

from __future__ import annotations

import fcntl
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class Busy(Exception):
    """Another run is at work in a folder."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """The name of a file while it is written: it gets ``path`` when all is in it and on the disk, and goes if that
    fails. Several may write the same file at once; the last one counts."""
    new = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        yield new
        with new.open("rb") as file:
            os.fsync(file.fileno())
        new.replace(path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


@contextmanager
def only_one(path: Path, shared: bool = False) -> Iterator[None]:
    """Hold a file that marks a folder as being worked in. It is let go with the process, however that ends.

    Args:
        path: of the file; it stays.
        shared: others that share may hold it too.

    Raises:
        Busy: another run holds it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+") as file:
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise Busy(f"{path.parent}: another run is at work there; wait for its end, or stop it") from error
        yield
