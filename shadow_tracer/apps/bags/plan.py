# SPDX-License-Identifier: Apache-2.0
"""A plan: which windows of which bags are to be played, as a JSON file that people can read and machines share.

Each bag is read once for it (:mod:`survey`); nothing of it has to be read again to play a window but what is in it, and
meshes before it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer import __version__
from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bag.reader import Recording
from shadow_tracer.apps.bag.survey import Survey, survey
from shadow_tracer.apps.bags.jobs import Job, Options
from shadow_tracer.apps.fleet.files import whole

FORMAT = 1  # of plans and parts
HIDDEN = ".plan"  # folder in the output for what is of no use after it
_ENDS = 1 << 16  # bytes at both ends of a file by which it is known; an mcap has its summary there


@dataclasses.dataclass(frozen=True)
class Cut:
    """How bags are cut: windows of so many depth images, or of so many seconds of the log."""

    frames: int = 500
    seconds: float | None = None

    def times(self, times: Any) -> list[int]:
        """First times of all windows but the first [ns], of the times of depth images in order."""
        if not len(times):
            return []
        if self.seconds is None:
            return [int(times[at]) for at in range(self.frames, len(times), self.frames) if times[at] > times[at - 1]]
        step = max(1, round(self.seconds * 1e9))
        numbers = (times - times[0]) // step
        return [int(times[at]) for at in range(1, len(times)) if numbers[at] > numbers[at - 1]]


@dataclasses.dataclass
class Window:
    """Half-open in the time of the log [ns], None being the beginning or end of the bag, and its depth images."""

    start: int | None
    stop: int | None
    frames: int


@dataclasses.dataclass
class Entry:
    """A bag of a plan.

    Attributes:
        bag: its path.
        key: of its contents, the options and the program's version.
        folder: where its output goes, below that of the plan.
        name: that of its output; parts add a number.
        frames: depth images.
        windows: in order.
        notes: what was chosen or is doubtful, a sentence each.
        refused: what cannot be used of transforms, poses of the camera and camera_info: how many and why, by input.
        error: why it cannot be played; "" if it can.
    """

    bag: str
    key: str
    folder: str
    name: str
    frames: int = 0
    windows: list[Window] = dataclasses.field(default_factory=list)
    notes: list[str] = dataclasses.field(default_factory=list)
    refused: dict[str, Any] = dataclasses.field(default_factory=dict)
    error: str = ""


@dataclasses.dataclass
class Plan:
    """All of it. ``out`` is the folder of the output."""

    out: str
    options: Options
    entries: list[Entry]

    def jobs(self) -> Iterator[Job]:
        """All jobs, in order."""
        for entry in self.entries:
            yield from self.jobs_of(entry)

    def jobs_of(self, entry: Entry) -> Iterator[Job]:
        """The jobs of a bag, in order."""
        out = Path(self.out)
        for number, window in enumerate(entry.windows):
            key = _digest(entry.key, window.start, window.stop)
            part = out / entry.folder / f"{entry.name}_{number:04d}.mcap"
            yield Job(
                key, entry.bag, str(self.survey(entry)), str(part), window.start, window.stop, window.frames,
                self.options,
            )  # fmt: skip

    def survey(self, entry: Entry) -> Path:
        """File of the survey of a bag."""
        return Path(self.out) / HIDDEN / f"{entry.name}.npz"

    def save(self, path: Path) -> None:
        """Write the file, whole or not at all."""
        content = {"format": FORMAT, "version": __version__, **dataclasses.asdict(self)}
        with whole(path) as new:
            new.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def load(path: Path) -> Plan:
        """Read a file.

        Raises:
            BagError: it is none, or of another version of the program.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            form, version = content["format"], content["version"]
            if (form, version) != (FORMAT, __version__):
                raise BagError(f"{path}: was made by version {version}, this is {__version__}; plan again")
            entries = [
                Entry(**{**each, "windows": [Window(**window) for window in each["windows"]]})
                for each in content["entries"]
            ]
            return Plan(content["out"], Options(**content["options"]), entries)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise BagError(f"{path}: expected a plan of shadow_tracer bags: {error}") from error


def make(
    bags: Sequence[Path], out: Path, options: Options, cut: Cut, known: Plan | None, one: bool,
    done: Callable[[], None] = lambda: None,
) -> Plan:  # fmt: skip
    """Plan bags; one that cannot be read gets an ``error``. Surveys go below ``out``.

    Args:
        bags: the recordings.
        out: folder of the output.
        options: what all jobs have in common.
        cut: how they are cut.
        known: an earlier plan, of which bags are taken over that are the same.
        one: the only bag's output is the folder ``out`` itself.
        done: called after each bag.

    Raises:
        OSError: a survey cannot be written.
    """
    plan = Plan(str(out.absolute()), options, [])
    (out / HIDDEN).mkdir(parents=True, exist_ok=True)
    taken: dict[str, int] = {}
    for bag in bags:
        name = bag.stem if bag.suffix else bag.name
        taken[name] = taken.get(name, 0) + 1
        name = name if taken[name] == 1 else f"{name}-{taken[name]}"
        entry = Entry(str(bag.absolute()), "", "." if one else name, name)
        try:
            entry.key = _digest(_known_by(bag), options, cut)
            same = [each for each in known.entries if not each.error and _same(each, entry)] if known else []
            if same and plan.survey(entry).exists():
                entry = same[0]
            else:
                _survey(entry, plan, cut)
        except (BagError, OSError) as error:
            entry.error = str(error)
        plan.entries.append(entry)
        done()
    return plan


def _same(one: Entry, other: Entry) -> bool:
    return (one.key, one.bag, one.name, one.folder) == (other.key, other.bag, other.name, other.folder)


def _survey(entry: Entry, plan: Plan, cut: Cut) -> None:
    settings = plan.options.settings
    lights = [light.name for light in settings.lights if light.type != "sun"]
    with Recording(Path(entry.bag), plan.options.names, lights, settings.max_rays) as recording:
        found = survey(recording, settings)
        entry.notes = [*recording.notes, *(f"warning: {text}" for text in recording.warnings)]
    entry.frames, entry.refused = len(found.frames), {name: list(pair) for name, pair in found.refused.items()}
    cuts = [] if found.whole else cut.times(found.frames[:, 0])
    entry.notes += [f"note: it is not cut: {reason}" for reason in found.whole]
    limits = [None, *cuts, None]
    places = [0, *np.searchsorted(found.frames[:, 0], cuts).tolist(), entry.frames]
    entry.windows = [
        Window(limits[n], limits[n + 1], places[n + 1] - places[n]) for n in range(len(limits) - 1)
    ]  # fmt: skip
    _write_survey(found, plan.survey(entry))


def _write_survey(found: Survey, path: Path) -> None:
    with whole(path) as new:
        found.save(new)


def _known_by(bag: Path) -> str:
    """What tells one bag from another: sizes, and both ends of each file."""
    digest = hashlib.sha256()
    if not bag.exists():
        raise BagError(f"{bag}: there is no such bag")
    for file in sorted(path for path in bag.rglob("*") if path.is_file()) if bag.is_dir() else [bag]:
        size = file.stat().st_size
        with file.open("rb") as stream:
            digest.update(f"{file.name if bag.is_dir() else ''} {size}\n".encode() + stream.read(_ENDS))
            stream.seek(max(0, size - _ENDS))
            digest.update(stream.read())
    return digest.hexdigest()


def _digest(*parts: Any) -> str:
    plain = [dataclasses.asdict(part) if dataclasses.is_dataclass(part) else part for part in parts]  # type: ignore[arg-type]
    text = json.dumps([FORMAT, __version__, *plain], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()
