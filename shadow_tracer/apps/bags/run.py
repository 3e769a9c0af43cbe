# SPDX-License-Identifier: Apache-2.0
"""From a plan to bags: what is left is played by an engine, and each bag is committed once its windows are there."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bags.folder import LOCK, commit, committed, merged, report_of
from shadow_tracer.apps.bags.jobs import Job, Report
from shadow_tracer.apps.bags.plan import HIDDEN, Entry, Plan
from shadow_tracer.apps.fleet.engines import Engine
from shadow_tracer.apps.fleet.files import only_one

ALL, SOME, UNFINISHED, UNKNOWN = 0, 1, 3, 3  # exit codes; the last one is that of the program for one bag


def good(report: Report) -> bool:
    """Whether a job left a part."""
    return not report.error


class Log:
    """Lines on stderr for people, or JSON, an object a line, for programs.

    Args:
        as_json: which.
    """

    def __init__(self, as_json: bool) -> None:
        self._json = as_json

    def say(self, event: str, text: str, **values: Any) -> None:
        """An event, for programs with its values, for people by its text; one without text they do not see."""
        if self._json:
            print(json.dumps({"event": event, **values, **({"text": text} if text else {})}), file=sys.stderr)
        elif text:
            print(text, file=sys.stderr)

    def bar(self, total: int, before: int) -> Bar:
        """A bar for all frames."""
        return Bar(total, before, not self._json)


class Bar:
    """Frames of all bags, on stderr. Use as a context manager."""

    def __init__(self, total: int, before: int, shown: bool) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("frames"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), disable=not shown)
        self._task = self._progress.add_task("frames", total=total, completed=before)

    def __enter__(self) -> Bar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def advance(self, frames: int) -> None:
        """So many more are done."""
        self._progress.advance(self._task, frames)


@dataclasses.dataclass
class Outcome:
    """What came of a run: why jobs failed, by bag."""

    failed: dict[str, str]


def run(plan: Plan, engine: Engine, log: Log, keep_going: bool, shard: tuple[int, int] | None = None) -> Outcome:
    """Play the windows that are not there yet.

    Args:
        plan: what is to be done.
        engine: who does it.
        log: where events are written.
        keep_going: after a failure do the rest as well.
        shard: (number from 0, count): only each count-th job.

    Raises:
        Busy: another run is at work on the same jobs.
    """
    hidden = Path(plan.out) / HIDDEN
    with only_one(hidden / LOCK, shared=shard is not None):
        if shard is None:
            return _run(list(plan.jobs()), engine, log, keep_going)
        number, count = shard
        with only_one(hidden / f"{LOCK}-{number}-{count}"):
            return _run(list(plan.jobs())[number::count], engine, log, keep_going)


class _Stop(Exception):
    pass


def _run(jobs: list[Job], engine: Engine, log: Log, keep_going: bool) -> Outcome:
    left = [job for job in jobs if report_of(job) is None]
    total = sum(job.frames for job in jobs)
    failed: dict[str, str] = {}
    with log.bar(total, total - sum(job.frames for job in left)) as bar:

        def done(job: Job, result: Any) -> None:
            text = str(result) or type(result).__name__ if isinstance(result, BaseException) else result.error
            if text:
                failed[job.bag] = text
                log.say("failed", "", bag=job.bag, part=job.part, error=text)
                if not keep_going:
                    raise _Stop
                return
            log.say("part", "", part=job.part, frames=job.frames, seconds=result.seconds, host=result.host)
            bar.advance(job.frames)

        try:
            if left:
                engine(left, done)
        except _Stop:
            pass
    return Outcome(failed)


class Watch:
    """How far a plan is, by its parts, whoever makes them. A part that was seen whole is not read again.

    Args:
        plan: the plan.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._jobs = [list(plan.jobs_of(entry)) for entry in plan.entries]
        self._seen: set[str] = set()

    @property
    def frames(self) -> int:
        """Depth images of the parts that are there."""
        for jobs in self._jobs:
            self._seen |= {job.part for job in jobs if job.part not in self._seen and report_of(job) is not None}
        return sum(job.frames for jobs in self._jobs for job in jobs if job.part in self._seen)

    @property
    def done(self) -> bool:
        """Whether all parts were there when :attr:`frames` was asked for."""
        return all(job.part in self._seen for jobs in self._jobs for job in jobs)

    def states(self) -> Iterator[tuple[Entry, int, int, bool]]:
        """Of each bag the frames that are done, the windows that are done, and whether it is committed."""
        for entry, jobs in zip(self._plan.entries, self._jobs, strict=True):
            if not entry.error and committed(self._plan, entry):
                yield entry, entry.frames, len(entry.windows), True
                continue
            done = [job for job in jobs if job.part in self._seen or report_of(job) is not None]
            yield entry, sum(job.frames for job in done), len(done), False


def follow(plan: Plan, log: Log, pause: float = 1.0) -> Watch:
    """Show a bar, or tell of frames, until all parts are there, whoever makes them; ``pause``: between looks [s]."""
    watch = Watch(plan)
    total, before = sum(entry.frames for entry in plan.entries), watch.frames
    with log.bar(total, before) as bar:
        log.say("progress", "", frames=before, total=total)
        while not watch.done:
            time.sleep(pause)
            if (now := watch.frames) != before:
                bar.advance(now - before)
                log.say("progress", "", frames=now, total=total)
                before = now
    return watch


def finish(plan: Plan, outcome: Outcome, log: Log, strict: bool, one: bool = False) -> int:
    """Commit the bags of which all windows are there, and say what came of each.

    Args:
        plan, outcome: what was to be done, and what came of it.
        log: where events are written.
        strict: something is wrong with a bag if nothing is known of any one image, or query.
        one: the program is the one for a single bag, which has an exit code for what is not known.

    Returns:
        The exit code.
    """
    failed = unfinished = unknown = 0
    for entry in plan.entries:
        error = entry.error or outcome.failed.get(entry.bag, "")
        if error:
            failed += 1
            log.say("bag_failed", f"failed: {entry.bag}: {error}", bag=entry.bag, error=error)
            continue
        if any(report_of(job) is None for job in plan.jobs_of(entry)):
            unfinished += 1
            log.say("bag_unfinished", f"not finished: {entry.bag}", bag=entry.bag)
            continue
        try:
            total = merged(entry, commit(plan, entry))
        except (BagError, OSError) as fault:
            failed += 1
            log.say("bag_failed", f"failed: {entry.bag}: {fault}", bag=entry.bag, error=str(fault))
            continue
        _tell(plan, entry, total, log)
        if (strict and (total.incomplete or not total.traced)) or (one and not total.traced):
            unknown += 1
            text = f"nothing is known of {total.frames - total.traced} of {total.frames} frames"
            text += ", or of queries (--strict)" if strict else ""
            log.say("bag_unknown", f"{'' if one else 'failed: '}{entry.bag}: {text}", bag=entry.bag, error=text)
    if failed or (unknown and not one):
        return SOME
    return UNFINISHED if unfinished else UNKNOWN if unknown else ALL


def _tell(plan: Plan, entry: Entry, total: Report, log: Log) -> None:
    numbers = {"frames": total.frames, "traced": total.traced, "windows": len(entry.windows)}
    where = Path(plan.out) / entry.folder
    text = f"{where}: {total.frames} frames, {total.traced} traced, {total.frames - total.traced} unknown"
    log.say("bag", text, bag=entry.bag, output=str(where), **numbers)
    said = [f"{what} ({count} frames)" for what, count in total.warnings.items()]
    said += [f"unknown, {count} times: {what}" for what, count in total.reasons.values()]
    said += [
        f"{name}: {count} messages were refused, the last one because of {what}"
        for name, (count, what) in sorted(total.refused.items())
    ]
    if total.passes > 1:
        said.append(f"the images start again {total.passes - 1} times at an earlier stamp; cut the bag there")
    if total.differing:
        said.append(f"{total.differing} pixels differ between two pipelines; please report this")
    for line in said:
        log.say("warning", f"warning: {entry.name}: {line}", bag=entry.bag)
