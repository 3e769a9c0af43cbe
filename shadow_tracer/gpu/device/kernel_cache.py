# SPDX-License-Identifier: Apache-2.0
"""Warp's cache of compiled kernels on disk, and modules in it that cannot be loaded.

A power cut or a full disk leaves a file there that is cut short, empty or all zeros. Warp then fails at every start,
for it compiles only what is not there. So the folder of such a module of ours, and nothing else, is removed once in a
process and the module is compiled again. Which one it is, Warp says only in words; where it does not, as of a JSON
file, every module of ours is looked at.
"""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import warp as wp

_Result = TypeVar("_Result")
_log = logging.getLogger(__name__)
_removed: set[Path] = set()  # each at most once in a process

_OURS = "wp_shadow_tracer."
_NOT_LOADED = re.compile(r"Failed to load \w+ module '([\w.]+)' .*module_hash=([0-9a-f]{7})")
_NO_KERNEL = re.compile(r"Failed to find forward kernel '\w+' from module '([\w.]+)'")


def mending(work: Callable[[], _Result]) -> _Result:
    """Do ``work``, again after a module has been removed from the cache because it could not be loaded.

    Args:
        work: may be done again from its start.

    Raises:
        RuntimeError: a module cannot be loaded and removing its folder did not help or is not possible; the message
            names the folder and what to do.
    """
    while True:
        try:
            return work()
        except Exception as error:
            folders = _damaged(error)
            if not folders:
                raise
            for folder in folders:
                _remove(folder, error)


def _damaged(error: Exception) -> list[Path]:
    """Folders of modules of ours that this error comes from; empty if it is another one."""
    cache = Path(wp.config.kernel_cache_dir)
    found = []
    if match := _NOT_LOADED.match(str(error)):
        found = [cache / f"wp_{match[1]}_{match[2]}"]
    elif match := _NO_KERNEL.match(str(error)):  # a file of zeros counts as loaded
        found = [file.parent for file in cache.glob(f"wp_{match[1]}_*/*.o") if not any(file.read_bytes())]
        wp.get_module(match[1]).unload()
    elif isinstance(error, ValueError) and _in_loading(error):  # of json or of the encoding
        found = [meta.parent for meta in cache.glob(f"{_OURS}*/*.meta") if not _is_json(meta)]
    return [folder for folder in found if folder.parent == cache and folder.name.startswith(_OURS)]


def _in_loading(error: Exception) -> bool:
    trace = error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        if code.co_name == "load" and Path(code.co_filename).is_relative_to(Path(wp.__file__).parent):
            return True
        trace = trace.tb_next
    return False


def _is_json(path: Path) -> bool:
    try:
        json.loads(path.read_bytes())
    except ValueError:
        return False
    except OSError:
        return True  # not there any more, or not ours to judge
    return True


def _remove(folder: Path, error: Exception) -> None:
    cure = f"delete {folder} and start again, or set WARP_CACHE_PATH to another folder"
    if folder in _removed:
        raise RuntimeError(f"kernel cache: {folder} cannot be loaded: {error}; {cure}") from error
    aside = folder.with_name(f"{folder.name}.damaged.{os.getpid()}")  # by one step: other processes use the cache too
    try:
        os.rename(folder, aside)
    except FileNotFoundError:
        pass  # another process was faster
    except OSError as refused:
        text = f"kernel cache: {folder} cannot be loaded ({error}) and not be removed ({refused}); {cure}"
        raise RuntimeError(text) from error
    shutil.rmtree(aside, ignore_errors=True)
    _removed.add(folder)
    _log.warning(
        "kernel cache: %s was damaged and has been removed; its kernels are compiled again (%s)", folder, error
    )
