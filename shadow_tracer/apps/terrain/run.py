# SPDX-License-Identifier: Apache-2.0
"""All tiles of a plan, by this process or an engine of :mod:`fleet`, each tile into a file: a run that was interrupted
goes on where it was."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import pickle
import shutil
import threading
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer import ShadowTracer, __version__
from shadow_tracer.apps.fleet.engines import Engine
from shadow_tracer.apps.fleet.files import whole
from shadow_tracer.apps.terrain.georeference import TerrainError
from shadow_tracer.apps.terrain.reading import Source
from shadow_tracer.terrain.plan import Plan, Window
from shadow_tracer.terrain.tile import TileResult, solve, tracer_for

_FORMAT = 1  # of the files of tiles
LOCK = "lock"
_SHARED = "shared.pickle"  # no more to be trusted than the folder is


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
        self._folder = folder = folder.absolute()
        mark, ours = folder / "run.json", json.dumps({"key": key, "version": __version__}).encode()
        known = mark.is_file() and mark.read_bytes() == ours
        if known and not restart:
            return
        folder.mkdir(parents=True, exist_ok=True)
        there = [path for path in folder.iterdir() if path.name != LOCK]
        # A run that was interrupted before there was a mark has left nothing else.
        if not restart and any(path.suffix != ".part" for path in there):
            raise TerrainError(
                f"{folder}: holds tiles of a run with other options, or of another file; --restart throws them away"
            )
        for path in there:
            path.unlink()
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

    def share(self, shared: Shared) -> str:
        """Write down what all tiles have in common; returns the file."""
        file = self._folder / _SHARED
        with whole(file) as new:
            new.write_bytes(pickle.dumps(shared))
        return str(file)

    def known(self, job: Job) -> bool | None:
        """Whether the tile of a job is done; None if not, as engines ask for it."""
        return True if self.load(job.number) is not None else None

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


@dataclasses.dataclass(frozen=True)
class Shared:
    """What all tiles of a run have in common.

    Attributes:
        plan, source: what is asked.
        device: as for ShadowTracer.
        threads: cores that a tracer keeps busy; None is all of the process.
    """

    plan: Plan
    source: Source
    device: str | None
    threads: int | None


@dataclasses.dataclass(frozen=True)
class Job:
    """A tile, in words that can be sent anywhere: all else is in a file that all machines see.

    Attributes:
        shared: file of :class:`Shared`.
        number: of the tile.
        part: file to be written.
    """

    shared: str
    number: int
    part: str


class _Worker:
    """What a process keeps from tile to tile."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._tracer: ShadowTracer | None = None

    def do(self, number: int, path: Path) -> None:
        shared = self._shared
        if self._tracer is None:
            self._tracer = tracer_for(*shared.plan.largest, device=shared.device, threads=shared.threads)
        save(path, solve(shared.plan.tile(number, shared.source.read), self._tracer))


def answer(job: Job) -> bool:
    """Do a tile: its file is whole or not there, and the same whoever does it. What is in common stays for the next job
    of this process. Raises TerrainError, OSError."""
    with _turn:
        _workers.get(job.shared).do(job.number, Path(job.part))
    return True


class _Workers:
    """What was kept for the last job; mostly the next one is of the same run."""

    def __init__(self) -> None:
        self._known: tuple[object, _Worker] | None = None

    def get(self, path: str) -> _Worker:
        try:
            state = Path(path).stat()
            name = path, state.st_mtime_ns, state.st_size
            if self._known is None or self._known[0] != name:
                self._known = None  # its memory goes first
                self._known = name, _Worker(pickle.loads(Path(path).read_bytes()))
        except (OSError, pickle.UnpicklingError, EOFError) as error:
            raise TerrainError(f"{path}: cannot be read: {error}; run it again") from error
        return self._known[1]


_turn = threading.Lock()  # threads of one worker take turns
_workers = _Workers()


def run(shared: Shared, parts: Parts, engine: Engine | None, done: Callable[[int], None]) -> int:
    """Do all tiles that are not done yet.

    Args:
        shared: what is asked.
        parts: where results go.
        engine: who does them, calling :func:`answer`; None is this process.
        done: called with how many tiles more are done.

    Returns:
        How many were done before.

    Raises:
        TerrainError: heights cannot be read.
        RuntimeError, OSError: workers die, or cannot be reached.
    """
    plan = shared.plan
    left = [number for number in range(len(plan.tiles)) if parts.load(number) is None]
    before = len(plan.tiles) - len(left)
    done(before)
    if engine is None:
        worker = _Worker(shared)
        for number in left:
            worker.do(number, parts.path(number))
            done(1)
        return before

    def took(_: Job, result: bool | BaseException) -> None:
        if isinstance(result, BaseException):
            raise result
        done(1)

    if left:
        where = parts.share(shared)
        engine([Job(where, number, str(parts.path(number))) for number in left], took)
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
