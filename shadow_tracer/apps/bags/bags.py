# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer bags`: many recordings by many processes or machines. Here are options, errors and exit codes."""

from __future__ import annotations

import argparse
import glob
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shadow_tracer.apps.bag.bag import add_parameters, add_wishes, missing, wishes
from shadow_tracer.apps.bag.names import Names, parameters_of
from shadow_tracer.apps.fleet.engines import add_options, is_here

if TYPE_CHECKING:
    from shadow_tracer.apps.bags.plan import Plan
    from shadow_tracer.apps.bags.run import Log
    from shadow_tracer.apps.fleet.engines import Engine

ARRAYS = ("SLURM_ARRAY_TASK", "AWS_BATCH_JOB_ARRAY", "JOB_COMPLETION")
_STEPS = ("plan", "run", "status", "commit")

_DESCRIPTION = """\
Answers every depth image of many bags, as `shadow_tracer bag` does for one. Each bag is cut into windows, which worker
processes play; the output of a bag is a folder in OUT, a split bag. The same command goes on where it was interrupted.

  shadow_tracer bags IN... OUT             all of it
  shadow_tracer bags plan IN... OUT        by hand, on many machines that share OUT: first the plan, OUT/plan.json,
  shadow_tracer bags run OUT --shard 17/200   then a share of its windows each (numbers from 0),
  shadow_tracer bags status OUT            meanwhile how far they are,
  shadow_tracer bags commit OUT            and at the end the bags"""

_EXIT_CODES = """exit code:
  0  all bags were written (plan: planned; run: this share is done)
  1  some failed; they are named, the others are kept
  2  a wrong option, a package that is missing, or another run is at work in OUT
  3  not finished yet
  130  interrupted; what is done is kept"""


def _shard(text: str, environment: Any = os.environ) -> tuple[int, int] | None:
    """(number from 0, count) of ``--shard``, or of a job array. Raises ValueError."""
    if not text:
        text = _array(environment)
        if not text:
            return None
    number, found, count = text.partition("/")
    if not found or not number.isdecimal() or not count.isdecimal() or int(number) >= int(count):
        raise ValueError(f"--shard: expected number/count with a number from 0 to below the count, got {text!r}")
    return int(number), int(count)


def _array(environment: Any) -> str:
    """``number/count`` of the job array that this process belongs to, "" if to none. Raises ValueError."""
    if "SLURM_ARRAY_TASK_ID" in environment:
        first, count = environment.get("SLURM_ARRAY_TASK_MIN", "0"), environment.get("SLURM_ARRAY_TASK_COUNT", "")
        return f"{int(environment['SLURM_ARRAY_TASK_ID']) - int(first)}/{count}"
    for index, size in (
        ("AWS_BATCH_JOB_ARRAY_INDEX", "AWS_BATCH_JOB_ARRAY_SIZE"),
        ("JOB_COMPLETION_INDEX", "JOB_COMPLETION_COUNT"),
    ):
        if index in environment:
            if size not in environment:
                raise ValueError(f"--shard: {index} is set, but {size} is not; set it, or give --shard number/count")
            return f"{environment[index]}/{environment[size]}"
    return ""


def _inputs(patterns: Sequence[str]) -> list[Path]:
    """The bags that are meant. Raises ValueError."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        here = [pattern] if Path(pattern).exists() else sorted(glob.glob(pattern, recursive=True))
        if not here:
            raise ValueError(f"IN: nothing is called {pattern!r}")
        found |= {Path(path): None for path in here}
    return list(found)


def _cut(chosen: argparse.Namespace) -> Any:
    from shadow_tracer.apps.bags.plan import Cut

    if chosen.window is not None and chosen.frames is not None:
        raise ValueError("--window: expected without --frames")
    if chosen.window is None:
        frames = 500 if chosen.frames is None else chosen.frames
        if frames < 1:
            raise ValueError(f"--frames: expected at least 1, got {frames}")
        return Cut(frames)
    try:
        seconds = float(chosen.window.removesuffix("s"))
    except ValueError:
        seconds = 0.0
    if not 1e-3 <= seconds <= 1e6:
        raise ValueError(f"--window: expected seconds from 0.001 to 1e6, such as 60s, got {chosen.window!r}")
    return Cut(seconds=seconds)


def planned(chosen: argparse.Namespace, bags: Sequence[Path], log: Log, one: bool = False) -> Plan:
    """Make or take over the plan in OUT. Raises BagError, ValueError, OSError, Busy."""
    from shadow_tracer.apps.bag.bag import load_settings
    from shadow_tracer.apps.bags.folder import LOCK, PLAN, open_output
    from shadow_tracer.apps.bags.jobs import Options
    from shadow_tracer.apps.bags.plan import HIDDEN, make
    from shadow_tracer.apps.fleet.files import only_one
    from shadow_tracer.ros.parameters.former_names import renamed

    names = Names(chosen.node, chosen.remap)
    settings, _, warnings = load_settings(names, chosen.params_file, chosen.param, chosen.camera)
    values, _ = renamed(parameters_of(names.node, chosen.params_file, chosen.param))
    for warning in warnings:
        log.say("warning", f"warning: {warning}")
    if chosen.threads < 1:
        raise ValueError(f"--threads: expected at least 1, got {chosen.threads}")
    options = Options(chosen.node, list(chosen.remap), values, chosen.camera, wishes(chosen), chosen.threads)
    cut, out = _cut(chosen), chosen.output
    if (out / HIDDEN).is_dir():
        with only_one(out / HIDDEN / LOCK):
            known = open_output(out, chosen.restart)
    else:
        known = open_output(out, chosen.restart)
    with only_one(out / HIDDEN / LOCK):
        plan = make(bags, out, options, cut, known, one)
        if known is not None and [each.key for each in known.entries] != [each.key for each in plan.entries]:
            if not {each.key for each in known.entries if not each.error} <= {each.key for each in plan.entries}:
                raise ValueError(
                    f"{out}: holds a run with other options or of other bags; --restart throws it away, or choose "
                    "another folder"
                )
        plan.save(out / PLAN)
    for entry in plan.entries:
        for note in entry.notes:
            log.say("note", f"{entry.name}: {note}", bag=entry.bag)
    triangles, rays = settings.max_triangles, settings.max_rays
    text = f"{len(plan.entries)} bags, {sum(len(each.windows) for each in plan.entries)} windows, "
    text += f"{sum(each.frames for each in plan.entries)} frames; each worker: {chosen.threads} threads, buffers for "
    log.say("plan", f"{text}{triangles} triangles and {rays} pixels", plan=str(out / PLAN))
    return plan


def _engine(chosen: argparse.Namespace, plan: Plan) -> Engine:
    """Who does the work. Raises ValueError, ImportError."""
    from shadow_tracer.apps.bags.folder import report_of
    from shadow_tracer.apps.bags.jobs import play
    from shadow_tracer.apps.bags.run import good
    from shadow_tracer.apps.fleet.engines import engine_of

    workers = chosen.jobs or max(1, len(os.sched_getaffinity(0)) // plan.options.threads)
    return engine_of(chosen, workers, play, good, report_of)


def _warm(plan: Plan, log: Log) -> None:
    """Compile the kernels once, before many workers would, into the cache that they share."""
    from shadow_tracer.apps.bags.jobs import warm_up

    if any(entry.windows for entry in plan.entries):
        reserved = warm_up(plan.options)
        log.say("worker", f"each worker reserves {reserved / 1e6:.0f} MB, and more for meshes", bytes=reserved)


def everything(chosen: argparse.Namespace, bags: Sequence[Path], one: bool = False) -> int:
    """Plan, run and commit. Returns the exit code; raises as :func:`planned`, and ImportError."""
    from shadow_tracer.apps.bags.run import Log, finish, run

    log = Log(chosen.log_json)
    plan = planned(chosen, bags, log, one)
    if any(entry.error for entry in plan.entries) and not chosen.keep_going:
        for entry in plan.entries:
            if entry.error:
                log.say("bag_failed", f"failed: {entry.bag}: {entry.error}", bag=entry.bag, error=entry.error)
        return 1
    engine = _engine(chosen, plan)
    if is_here(chosen):
        _warm(plan, log)
    return finish(plan, run(plan, engine, log, chosen.keep_going), log, chosen.strict, one)


def _step(step: str, chosen: argparse.Namespace) -> int:
    from shadow_tracer.apps.bags.folder import PLAN
    from shadow_tracer.apps.bags.plan import Plan
    from shadow_tracer.apps.bags.run import Log, Outcome, Watch, finish, follow, run

    log = Log(chosen.log_json)
    if step == "plan":
        plan = planned(chosen, _inputs(chosen.bags), log)
        bad = [entry for entry in plan.entries if entry.error]
        for entry in bad:
            log.say("bag_failed", f"failed: {entry.bag}: {entry.error}", bag=entry.bag, error=entry.error)
        return 1 if bad else 0
    plan = Plan.load(chosen.output / PLAN if chosen.output.is_dir() else chosen.output)
    if step == "commit":
        return finish(plan, Outcome({}), log, chosen.strict)
    if step == "run":
        outcome = run(plan, _engine(chosen, plan), log, chosen.keep_going, _shard(chosen.shard))
        for bag, error in outcome.failed.items():
            log.say("bag_failed", f"failed: {bag}: {error}", bag=bag, error=error)
        return 1 if outcome.failed else 0
    left = faulty = 0
    for entry, frames, windows, whole in (follow(plan, log) if chosen.follow else Watch(plan)).states():
        state = "failed" if entry.error else "written" if whole else f"{windows} of {len(entry.windows)} windows"
        print(f"{entry.name}: {frames} of {entry.frames} frames, {state}{f': {entry.error}' if entry.error else ''}")
        faulty += bool(entry.error)
        left += not whole and not entry.error
    return 3 if left else 1 if faulty else 0


def add_engine(parser: argparse.ArgumentParser) -> None:
    """Options of who does the work."""
    parser.add_argument("--jobs", type=int, metavar="N", help="processes; default: cores by --threads")
    add_options(parser)
    parser.add_argument("--keep-going", action="store_true", help="do the other bags if one fails")


def add_cut(parser: argparse.ArgumentParser) -> None:
    """Options of how bags are cut."""
    parser.add_argument("--window", metavar="60s", help="seconds of the log in a window")
    parser.add_argument("--frames", type=int, metavar="N", help="depth images in a window (default: 500)")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="of a worker (default: %(default)s)")
    parser.add_argument("--restart", action="store_true", help="throw away what an earlier run left in OUT")


def _options(step: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"shadow_tracer bags {step}".rstrip(),
        description=_DESCRIPTION,
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if step in ("", "plan"):
        parser.add_argument("bags", nargs="+", metavar="IN", help="bags, or patterns in quotes")
        parser.add_argument("output", type=Path, metavar="OUT", help="folder")
        add_parameters(parser)
        add_wishes(parser)
        add_cut(parser)
    else:
        parser.add_argument("output", type=Path, metavar="OUT", help="folder of a plan, or its plan.json")
    if step in ("", "run"):
        add_engine(parser)
    if step == "run":
        parser.add_argument("--shard", default="", metavar="N/COUNT", help="default: from a job array; else everything")
    if step == "status":
        parser.add_argument("--follow", action="store_true", help="show a bar until all windows are there")
    if step in ("", "commit"):
        parser.add_argument("--strict", action="store_true", help="a bag fails if nothing is known of any one image")
    parser.add_argument("--log-json", action="store_true", help="events as JSON, one a line")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Returns the exit code, which ``--help`` explains."""
    given = sys.argv[1:] if arguments is None else arguments
    step = given[0] if given and given[0] in _STEPS else ""
    chosen = _options(step).parse_args(given[1:] if step else given)
    if text := missing():
        print(text, file=sys.stderr)
        return 2
    return guarded(lambda: _step(step, chosen) if step else everything(chosen, _inputs(chosen.bags)))


def one_bag(chosen: argparse.Namespace, more: Sequence[str]) -> int:
    """What ``shadow_tracer bag`` was asked for, by several processes; ``more``: options of this program."""
    parser = argparse.ArgumentParser()
    add_engine(parser)
    add_cut(parser)
    usual = parser.parse_args(list(more), argparse.Namespace(log_json=False))
    both = argparse.Namespace(**{**vars(usual), **vars(chosen)})
    return guarded(lambda: everything(both, [chosen.bag], one=True))


def guarded(act: Any) -> int:
    """The exit code of an act, or of what it raises."""
    from shadow_tracer.apps.bag.files import BagError
    from shadow_tracer.apps.fleet.files import Busy

    try:
        return int(act())
    except KeyboardInterrupt:
        print("bags: interrupted; the same command goes on", file=sys.stderr)
        return 130
    except (Busy, ValueError, ImportError) as error:
        print(f"bags: {error}", file=sys.stderr)
        return 2
    except (BagError, RuntimeError, OSError) as error:
        print(f"bags: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
