# SPDX-License-Identifier: Apache-2.0
"""All tiles of a plan, by one process or several, each tile into a file: a run that was interrupted goes on where it
was."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import multiprocessing
import os
import shutil
import zipfile
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer import ShadowTracer, __version__
from shadow_tracer.apps.terrain.georeference import TerrainError
from shadow_tracer.apps.terrain.reading import Source
from shadow_tracer.apps.terrain.writing import whole
from shadow_tracer.terrain.plan import Plan, Window
from shadow_tracer.terrain.tile import TileResult, solve, tracer_for

_FORMAT = 1  # of the files of tiles


class Parts:
    """A folder with a file for each tile that is done, and what they are answers to; each is whole or not there.

    Args:
        folder: made if it is not there.
        key: of the run.
        restart: throw away what is there of another run.

    Raises:
        TerrainError: the folder holds parts of another run.
    """

    def __init__(self, folder: Path, key: str, restart: bool) -> None:
        self._folder = folder
        mark, ours = folder / "run.json", json.dumps({"key": key, "version": __version__}).encode()
        known = mark.is_file() and mark.read_bytes() == ours
        if known and not restart:
            return
        if folder.exists():
            # A run that was interrupted before there was a mark has left nothing else.
            if not restart and any(path.suffix != ".part" for path in folder.iterdir()):
                raise TerrainError(
                    f"{folder}: holds tiles of a run with other options, or of another file; --restart throws them away"
                )
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
        with whole(mark) as new:
            new.write_bytes(ours)

    def path(self, number: int) -> Path:
        """The file of a tile."""
        return self._folder / f"{number:06d}.npz"

    def load(self, number: int) -> TileResult | None:
        """A tile that is done, or None: it is not there, or damaged."""
        try:
            with np.load(self.path(number), allow_pickle=False) as file:
                return TileResult(*(file[each.name] for each in dataclasses.fields(TileResult)))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
            return None

    def remove(self) -> None:
        """All of it."""
        shutil.rmtree(self._folder)


def save(path: Path, result: TileResult) -> None:
    """Write a tile to its file, whole or not at all."""
    fields = {each.name: getattr(result, each.name) for each in dataclasses.fields(TileResult)}
    with whole(path) as new, new.open("wb") as file:
        np.savez_compressed(file, **fields)


def key_of(plan: Plan, path: Path, *options: Any) -> str:
    """What a run depends on, in a few characters: the file, the plan, the program's version."""
    suns = plan.suns
    digest = hashlib.sha256()
    for part in (_FORMAT, __version__, str(path.resolve()), *options):
        digest.update(f"{part!r}\n".encode())
    for file in sorted(path.rglob("*")) if path.is_dir() else (path,):
        known = file.stat()
        digest.update(f"{file.name!r} {known.st_size!r} {known.st_mtime_ns!r}\n".encode())
    digest.update(f"{plan.grid!r} {plan.above!r} {plan.ceiling!r} {plan.tiles!r} {suns.stamps!r}".encode())
    for array in (suns.seconds, suns.towards, suns.irradiance):
        digest.update(array.tobytes())
    return digest.hexdigest()


@dataclasses.dataclass
class _Worker:
    """What a process keeps from tile to tile."""

    plan: Plan
    source: Source
    device: str | None
    threads: int | None
    tracer: ShadowTracer | None = None

    def do(self, number: int, path: Path) -> None:
        if self.tracer is None:
            self.tracer = tracer_for(*self.plan.largest, device=self.device, threads=self.threads)
        save(path, solve(self.plan.tile(number, self.source.read), self.tracer))


_worker: _Worker | None = None


def _begin(worker: _Worker) -> None:
    global _worker
    _worker = worker


def _work(number: int, path: Path) -> None:
    assert _worker is not None
    _worker.do(number, path)


def run(plan: Plan, source: Source, parts: Parts, jobs: int, device: str | None, done: Callable[[int], None]) -> int:
    """Do all tiles that are not done yet.

    Args:
        plan, source: what is asked.
        parts: where results go.
        jobs: processes.
        device: as for ShadowTracer.
        done: called with how many tiles more are done.

    Returns:
        How many were done before.

    Raises:
        TerrainError: heights cannot be read.
    """
    left = [number for number in range(len(plan.tiles)) if parts.load(number) is None]
    before = len(plan.tiles) - len(left)
    done(before)
    if jobs == 1 or len(left) < 2:
        worker = _Worker(plan, source, device, None)
        for number in left:
            worker.do(number, parts.path(number))
            done(1)
        return before
    worker = _Worker(plan, source, device, max(1, len(os.sched_getaffinity(0)) // jobs))
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, len(left)), mp_context=spawn, initializer=_begin, initargs=(worker,))
    # Few are handed over at a time, so that an interrupted run ends soon, however often Ctrl-C comes.
    ahead = iter(left)
    try:
        open_ones = {pool.submit(_work, number, parts.path(number)) for number in islice(ahead, 2 * jobs)}
        while open_ones:
            finished, open_ones = wait(open_ones, return_when=FIRST_COMPLETED)
            for each in finished:
                each.result()
                done(1)
            open_ones |= {pool.submit(_work, each, parts.path(each)) for each in islice(ahead, len(finished))}
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return before


def results(plan: Plan, parts: Parts) -> Iterator[tuple[Window, TileResult]]:
    """All tiles, one after the other.

    Raises:
        TerrainError: one has gone.
    """
    for number, tile in enumerate(plan.tiles):
        result = parts.load(number)
        if result is None:
            raise TerrainError(f"{parts.path(number)}: has gone or is damaged; run it again")
        yield tile.answered, result
