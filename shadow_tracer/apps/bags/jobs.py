# SPDX-License-Identifier: Apache-2.0
"""One job: a window of a bag, played into a part of the output. Everything here is plain data, and nothing is printed.

A job that runs twice writes the same bytes (without ``~/timing``), so it does no harm if an engine runs one again.
"""

from __future__ import annotations

import dataclasses
import json
import socket
import threading
import time
from pathlib import Path
from typing import Any

from shadow_tracer import ShadowTracer
from shadow_tracer.apps.bag.bag import of_camera
from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bag.names import Names
from shadow_tracer.apps.bag.player import Player, Result, Wish
from shadow_tracer.apps.bag.reader import Recording
from shadow_tracer.apps.bag.survey import Survey
from shadow_tracer.apps.bag.writer import Output
from shadow_tracer.ros.parameters.parameters import settings_from
from shadow_tracer.ros.settings import Settings

RECORD = "shadow_tracer"  # name of the record in the custom data of a part


@dataclasses.dataclass(frozen=True)
class Options:
    """What all jobs of a plan have in common.

    Attributes:
        node: full name of the node, for topics.
        remaps: ``from:=to``.
        parameters: the node's, by full name.
        camera: whose images, "" where there is one without a name.
        wish: what is written beside masks, by the names of :class:`Wish`.
        threads: cores that one worker keeps busy.
    """

    node: str
    remaps: list[str]
    parameters: dict[str, Any]
    camera: str
    wish: dict[str, bool]
    threads: int

    @property
    def settings(self) -> Settings:
        """The settings of the camera."""
        return self._made[0]

    @property
    def names(self) -> Names:
        """The names of the camera."""
        return self._made[1]

    @property
    def _made(self) -> tuple[Settings, Names]:
        return of_camera(settings_from(self.parameters), Names(self.node, self.remaps), self.camera)


@dataclasses.dataclass(frozen=True)
class Job:
    """A window, half-open in the time of the log.

    Attributes:
        key: of the bag, the options, the program's version and the window: what the part depends on.
        bag: the recording.
        survey: file of its survey.
        part: file to be written.
        start, stop: first time, and the time behind the last [ns]; None is the beginning or end of the bag.
        frames: depth images in it.
        options: what all jobs have in common.
    """

    key: str
    bag: str
    survey: str
    part: str
    start: int | None
    stop: int | None
    frames: int
    options: Options


@dataclasses.dataclass
class Report:
    """What came of a job; the part carries it as a record.

    Attributes:
        key: of the job.
        frames, traced: depth images that were answered, and those of which something is known.
        images: depth images in the window, good or not.
        counts: messages written, by topic.
        checksum: of all messages but ``~/timing``.
        reasons: why nothing is known of images or queries: first such text and how often, by text without numbers.
        refused: what could not be used: how many, and the last reason, by input.
        warnings: what was doubtful, and in how many frames.
        passes, verified, differing, parts: as in :class:`Result`.
        device: what it was traced on.
        error: why there is no part, "" if there is one.
        seconds, host: not in the record: they differ between two runs.
    """

    key: str
    frames: int = 0
    traced: int = 0
    images: int = 0
    counts: dict[str, int] = dataclasses.field(default_factory=dict)
    checksum: str = ""
    reasons: dict[str, Any] = dataclasses.field(default_factory=dict)
    refused: dict[str, Any] = dataclasses.field(default_factory=dict)
    warnings: dict[str, int] = dataclasses.field(default_factory=dict)
    passes: int = 1
    verified: int = 0
    differing: int = 0
    parts: list[str] = dataclasses.field(default_factory=list)
    device: str = ""
    error: str = ""
    seconds: float = 0.0
    host: str = ""

    def record(self) -> str:
        """What the part carries."""
        return json.dumps({k: v for k, v in vars(self).items() if k not in ("seconds", "host", "error")})

    @staticmethod
    def of_record(text: str) -> Report:
        """The report of a part. Raises ValueError, TypeError."""
        return Report(**json.loads(text))

    @property
    def incomplete(self) -> bool:
        """Whether nothing is known of some image or query."""
        return bool(self.reasons or {"depth", "query"} & self.refused.keys())


def play(job: Job) -> Report:
    """Play a window into its part. What goes wrong with the bag stands in the report; the part is whole or not there.

    The tracer and the survey are kept for the next job of this process, where that one needs the same.
    """
    start = time.monotonic()
    try:
        with _turn:
            report = _play(job)
    except (BagError, ValueError, RuntimeError, ImportError, OSError) as error:
        report = Report(job.key, error=f"{type(error).__name__}: {error}" if not str(error) else str(error))
    report.seconds, report.host = time.monotonic() - start, socket.gethostname()
    return report


def _play(job: Job) -> Report:
    options, settings, names = job.options, job.options.settings, job.options.names
    lights = [light.name for light in settings.lights if light.type != "sun"]
    survey = _surveys.get(job.survey)
    tracer = _tracers.get(options)
    images = 0

    def count() -> None:
        nonlocal images
        images += 1

    with Recording(Path(job.bag), names, lights, settings.max_rays) as recording:
        part = Path(job.part)
        part.parent.mkdir(parents=True, exist_ok=True)
        with Output(part, overwrite=True) as output:
            player = Player(
                recording, survey.background(settings), settings, tracer, output, names, Wish(**options.wish)
            )
            if job.start is not None:
                player.seek(survey, job.start)
            result = player.play(count, job.stop)
            report = _report(job.key, result, output, tracer)
            report.images = images
            if images != job.frames:
                raise BagError(f"{job.bag}: has {images} depth images where {job.frames} were planned; plan again")
            output.note(RECORD, report.record())
    return report


def _report(key: str, result: Result, output: Output, tracer: ShadowTracer) -> Report:
    return Report(
        key,
        result.frames,
        result.traced,
        counts=dict(sorted(output.counts.items())),
        checksum=output.checksum,
        reasons={name: list(pair) for name, pair in result.reasons.items()},
        refused={name: list(pair) for name, pair in result.refused.items()},
        warnings=dict(result.warnings),
        passes=result.passes,
        verified=result.verified,
        differing=result.differing,
        parts=list(result.parts),
        device=tracer.device,
    )


def warm_up(options: Options) -> int:
    """Make the kernels that these options need, which the cache keeps for other processes. Returns how many bytes a
    tracer with them reserves. Raises as ShadowTracer."""
    reserved = _tracers.get(options).device_bytes
    _tracers.forget()
    return reserved


class _Surveys:
    """The survey that was used last; mostly the next job is of the same bag."""

    def __init__(self) -> None:
        self._known: tuple[object, Survey] | None = None

    def get(self, path: str) -> Survey:
        """Read a survey, or take the one that is known."""
        try:
            state = Path(path).stat()
        except OSError as error:
            raise BagError(f"{path}: what was planned is not there: {error}; plan again") from error
        name = path, state.st_mtime_ns, state.st_size
        if self._known is None or self._known[0] != name:
            self._known = name, Survey.load(Path(path))
        return self._known[1]


class _Tracers:
    """The tracer that was used last, which the next job gets with an empty scene if its settings ask for the same."""

    def __init__(self) -> None:
        self._known: tuple[object, ShadowTracer] | None = None

    def forget(self) -> None:
        """Let the tracer go."""
        self._known = None

    def get(self, options: Options) -> ShadowTracer:
        """A tracer for these options."""
        settings = options.settings
        wanted = settings.pipeline, settings.variant, settings.tracer_device, settings.bounds, options.threads
        if self._known is None or self._known[0] != wanted:
            self._known = None  # its memory goes first
            tracer = ShadowTracer(
                settings.pipeline,
                settings.variant or None,
                device=settings.tracer_device,
                bounds=settings.bounds,
                threads=options.threads,
            )
            tracer.warm_up()
            self._known = wanted, tracer
        self._known[1].scene.clear()
        return self._known[1]


_turn = threading.Lock()  # threads of one worker take turns
_surveys, _tracers = _Surveys(), _Tracers()
