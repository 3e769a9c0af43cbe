# SPDX-License-Identifier: Apache-2.0
"""Who does the jobs of a program: options of its command line, and what they choose."""

from __future__ import annotations

import argparse
import importlib.util
import os
from collections.abc import Callable, Sequence
from typing import Any

from shadow_tracer.apps.fleet.local import run_local

Engine = Callable[[Sequence[Any], Callable[[Any, Any], None]], None]
"""Does jobs, and calls a function once for each with the job and its result, or what was raised."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of who does the work, but for ``--jobs``, whose default is that of the program."""
    parser.add_argument("--engine", choices=("local", "dask"), default="local", help="default: %(default)s")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="of Dask, such as tcp://host:8786")
    parser.add_argument("--scheduler-file", default="", metavar="FILE", help="that Dask's scheduler wrote")
    parser.add_argument("--retries", type=int, default=2, metavar="N", help="of a job (default: %(default)s)")


def check_options(chosen: argparse.Namespace) -> None:
    """Raises:
    ValueError: an option is bad.
    ImportError: a package is missing.
    """
    if chosen.jobs is not None and chosen.jobs < 1:
        raise ValueError(f"--jobs: expected at least 1, got {chosen.jobs}")
    if chosen.retries < 0:
        raise ValueError(f"--retries: expected at least 0, got {chosen.retries}")
    if chosen.engine == "local":
        if chosen.scheduler or chosen.scheduler_file:
            raise ValueError("--scheduler: expected with --engine dask")
        return
    if chosen.scheduler and chosen.scheduler_file:
        raise ValueError("--scheduler: expected without --scheduler-file")
    if importlib.util.find_spec("distributed") is None:
        raise ImportError("--engine dask needs distributed: pip install 'shadow_tracer[fleet]'")


def _address(chosen: argparse.Namespace) -> str:
    """Of the scheduler; "" if a file says it, or if there is none."""
    return chosen.scheduler or ("" if chosen.scheduler_file else os.environ.get("DASK_SCHEDULER_ADDRESS", ""))


def is_here(chosen: argparse.Namespace) -> bool:
    """Whether all workers are processes of this machine that are started for these jobs."""
    return chosen.engine == "local" or not (_address(chosen) or chosen.scheduler_file)


def engine_of(
    chosen: argparse.Namespace, workers: int, work: Callable[[Any], Any], good: Callable[[Any], bool],
    known: Callable[[Any], Any],
) -> Engine:  # fmt: skip
    """What the options ask for.

    Args:
        chosen: the options.
        workers: processes, where none are there already.
        work: a function of a module, called with a job.
        good: whether its result is one that stays; others are tried again.
        known: the result of a job that is done already, or None.

    Raises:
        ValueError, ImportError: as :func:`check_options`.
    """
    check_options(chosen)
    if chosen.engine == "local":
        return lambda jobs, done: run_local(work, jobs, workers, chosen.retries, good, done)
    from shadow_tracer.apps.fleet.cluster import run_dask

    where = _address(chosen)
    return lambda jobs, done: run_dask(
        work, jobs, where, chosen.scheduler_file, workers, chosen.retries, good, known, done
    )
