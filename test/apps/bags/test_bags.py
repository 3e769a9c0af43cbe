# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer bags`: what it writes, takes up again, refuses and says with its exit code."""

from __future__ import annotations

import argparse
import errno
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_journey import DEPTH, FOCAL, INFO, SECOND, log_of
from bag_maker import BagMaker, image, info, read, transform
from bags_runs import PARAMETERS, given, perilous, uncut
from rosbags.rosbag2 import Reader

from shadow_tracer.apps import cli
from shadow_tracer.apps.bag import writer
from shadow_tracer.apps.bags import bags
from shadow_tracer.apps.bags.folder import report_of
from shadow_tracer.apps.bags.jobs import Report, play
from shadow_tracer.apps.bags.plan import Cut, Plan
from shadow_tracer.apps.fleet.files import Busy, only_one, whole
from shadow_tracer.apps.fleet.local import run_local

OPTIONS = ["--no-timing", *given(PARAMETERS)]
W, H = 10, 8


def small(frames: int) -> BagMaker:
    """A few images before a wall."""
    made = BagMaker()
    made.add("/tf_static", transform("odom", "camera", 0, (0.0, 0.0, 0.0)))
    for k in range(frames):
        stamp = 100 * SECOND + k * SECOND // 8
        made.add(INFO, info(W, H, stamp, FOCAL / 4))
        made.add(DEPTH, image(np.full((H, W), 1500 + 10 * k, np.uint16), stamp))
    return made


def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let an engine of one worker be this process."""

    def run(work: Any, jobs: Any, workers: int, retries: int, good: Any, done: Any) -> None:
        for job in jobs:
            done(job, work(job))

    monkeypatch.setattr("shadow_tracer.apps.fleet.engines.run_local", run)


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def test_the_output_is_a_split_bag_and_a_second_run_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    in_this_process(monkeypatch)
    for name, frames in (("five", 5), ("one", 1)):
        small(frames).write(tmp_path / name)
    out = tmp_path / "out"
    command = ["bags", str(tmp_path / "five"), str(tmp_path / "one"), str(out), *OPTIONS, "--frames", "2"]
    assert cli.main(command) == 0
    assert sorted(bytes_of(out / "five")) == [*(f"five_000{n}.mcap" for n in range(3)), "metadata.yaml"]
    for name in ("five", "one"):
        expected = log_of(uncut(tmp_path / name, tmp_path / f"{name}.mcap", PARAMETERS))
        assert log_of(out / name) == expected
        with Reader(out / name) as reader:
            assert reader.message_count == len(expected) > 0
    before = {path: path.stat().st_mtime_ns for path in out.glob("*/*.mcap")}
    assert cli.main(command) == 0
    assert {path: path.stat().st_mtime_ns for path in out.glob("*/*.mcap")} == before
    (out / "five" / "five_0001.mcap").write_bytes((out / "five" / "five_0001.mcap").read_bytes()[:-100])
    assert cli.main(["bags", "commit", str(out)]) == 3
    first = bytes_of(out / "five")
    assert cli.main(command) == 0
    again = bytes_of(out / "five")
    assert [name for name in first if first[name] != again[name]] == ["five_0001.mcap"]
    assert cli.main([*command, "--param", "lights.lamp.enabled:=false"]) == 2
    assert "--restart" in capsys.readouterr().err
    assert bytes_of(out / "five") == again
    assert cli.main([*command, "--param", "lights.lamp.enabled:=false", "--restart"]) == 0
    assert "/shadow_tracer/mask/lamp" not in read(out / "five")


def test_one_bag_by_several(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_this_process(monkeypatch)
    bag = small(3).write(tmp_path / "in")
    assert cli.main(["bag", str(bag), str(tmp_path / "out"), *OPTIONS, "--jobs", "2"]) == 0
    assert log_of(tmp_path / "out") == log_of(uncut(bag, tmp_path / "whole.mcap", PARAMETERS))
    assert cli.main(["bag", str(bag), str(tmp_path / "out.mcap"), *OPTIONS, "--jobs", "2"]) == 1
    assert cli.main(["bag", str(bag), str(tmp_path / "other"), *OPTIONS, "--jobs", "0"]) == 2


@pytest.mark.parametrize("jobs", [[], ["--jobs", "2"]], ids=["alone", "by two"])
def test_what_is_not_known_has_the_exit_code_of_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], jobs: list[str]
) -> None:
    """One image of two in a frame that nobody knows; then both."""
    in_this_process(monkeypatch)
    for lost in (1, 2):
        made = small(2 - lost)
        for k in range(lost):
            stamp = (200 + k) * SECOND
            made.add(INFO, info(W, H, stamp, FOCAL / 4, "nowhere"))
            made.add(DEPTH, image(np.full((H, W), 1500, np.uint16), stamp, "nowhere"))
        bag = made.write(tmp_path / f"in{lost}")
        for strict in ([], ["--strict"]):
            out = tmp_path / f"out{lost}{len(strict)}"
            expected = 3 if strict or lost == 2 else 0
            assert cli.main(["bag", str(bag), str(out), *OPTIONS, *jobs, *strict]) == expected
            assert (out / "metadata.yaml").exists()
    command = ["bags", str(tmp_path / "in1"), str(tmp_path / "bags"), *OPTIONS]
    assert cli.main(command) == 0 and cli.main([*command, "--strict"]) == 1
    assert "failed: " in capsys.readouterr().err


def test_a_broken_bag_is_named_and_the_others_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    in_this_process(monkeypatch)
    small(2).write(tmp_path / "good")
    small(0).write(tmp_path / "nothing")
    (tmp_path / "broken.mcap").write_bytes(b"no bag")
    names = [str(tmp_path / name) for name in ("broken.mcap", "nothing", "good")]
    assert cli.main(["bags", *names, str(tmp_path / "out"), *OPTIONS]) == 1
    assert not (tmp_path / "out" / "good").exists()
    assert cli.main(["bags", *names, str(tmp_path / "out"), *OPTIONS, "--keep-going", "--log-json"]) == 1
    events = [json.loads(line) for line in capsys.readouterr().err.splitlines() if line.startswith("{")]
    assert [event["bag"] for event in events if event["event"] == "bag_failed"] == names[:2]
    assert len(log_of(tmp_path / "out" / "good")) > 0
    assert cli.main(["bags", "status", str(tmp_path / "out")]) == 1
    assert "good: 2 of 2 frames, written" in capsys.readouterr().out


def test_shards_by_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    in_this_process(monkeypatch)
    bag, out = small(5).write(tmp_path / "in"), str(tmp_path / "out")
    assert cli.main(["bags", "plan", str(bag), out, *OPTIONS, "--window", "0.004s"]) == 0
    assert cli.main(["bags", "status", out]) == 3
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "8")
    monkeypatch.setenv("SLURM_ARRAY_TASK_MIN", "7")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")
    assert cli.main(["bags", "run", out]) == 0
    assert cli.main(["bags", "commit", out]) == 3
    assert "in: 2 of 5 frames" in (cli.main(["bags", "status", out]) and capsys.readouterr().out)
    assert cli.main(["bags", "run", out, "--shard", "2/2"]) == 2
    seen: list[str] = []

    def goes_on(_: float) -> None:
        seen.append(capsys.readouterr().err)
        assert cli.main(["bags", "run", str(tmp_path / "out" / "plan.json"), "--shard", "0/2"]) == 0

    monkeypatch.setattr("shadow_tracer.apps.bags.run.time.sleep", goes_on)
    assert cli.main(["bags", "status", out, "--follow", "--log-json"]) == 3
    lines = "".join([*seen, capsys.readouterr().err]).splitlines()
    told = [json.loads(line) for line in lines if line.startswith("{")]
    assert [each["frames"] for each in told if each["event"] == "progress"] == [2, 5]
    assert cli.main(["bags", "status", out]) == 3
    assert cli.main(["bags", "commit", out]) == 0
    assert cli.main(["bags", "status", out]) == 0
    assert log_of(tmp_path / "out" / "in") == log_of(uncut(bag, tmp_path / "whole.mcap", PARAMETERS))


def test_the_second_run_in_a_folder_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, out = small(1).write(tmp_path / "in"), tmp_path / "out"
    assert cli.main(["bags", "plan", str(bag), str(out), *OPTIONS]) == 0
    with only_one(out / ".plan" / "lock"):
        for command in (["bags", str(bag), str(out), *OPTIONS], ["bags", "run", str(out), "--shard", "0/2"]):
            assert cli.main(command) == 2
            assert "another run is at work" in capsys.readouterr().err
    with only_one(tmp_path / "a", shared=True), only_one(tmp_path / "a", shared=True):
        with pytest.raises(Busy), only_one(tmp_path / "a"):
            pass


def test_a_full_disk_leaves_nothing_half_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    in_this_process(monkeypatch)
    bag, out = small(4).write(tmp_path / "in"), tmp_path / "out"
    put, count = writer.Writer.write, 0

    def full(*arguments: Any) -> None:
        nonlocal count
        count += 1
        if count > 14:
            raise OSError(errno.ENOSPC, "No space left on device")
        put(*arguments)

    monkeypatch.setattr(writer.Writer, "write", full)
    command = ["bags", str(bag), str(out), *OPTIONS, "--frames", "2"]
    assert cli.main(command) == 1
    assert "No space left" in capsys.readouterr().err
    assert sorted(bytes_of(out / "in")) == ["in_0000.mcap"]
    assert [path.name for path in (out / "in").iterdir()] == ["in_0000.mcap"]
    monkeypatch.setattr(writer.Writer, "write", put)
    assert cli.main(command) == 0
    assert log_of(out / "in") == log_of(uncut(bag, tmp_path / "whole.mcap", PARAMETERS))


@pytest.mark.parametrize(
    "environment, expected",
    [
        ({}, None),
        ({"AWS_BATCH_JOB_ARRAY_INDEX": "3", "AWS_BATCH_JOB_ARRAY_SIZE": "9"}, (3, 9)),
        ({"JOB_COMPLETION_INDEX": "0", "JOB_COMPLETION_COUNT": "1"}, (0, 1)),
    ],
)
def test_job_arrays(environment: dict[str, str], expected: tuple[int, int] | None) -> None:
    assert bags._shard("", environment) == expected
    assert bags._shard("17/200", environment) == (17, 200)


@pytest.mark.parametrize("text", ["3/3", "1", "-1/3", "a/b", "1/"])
def test_no_shard(text: str) -> None:
    with pytest.raises(ValueError, match="--shard"):
        bags._shard(text, {})
    with pytest.raises(ValueError, match="JOB_COMPLETION_COUNT"):
        bags._shard("", {"JOB_COMPLETION_INDEX": "0"})


@pytest.mark.parametrize("options", [["--frames", "0"], ["--window", "x"], ["--window", "1s", "--frames", "1"]])
def test_no_window(options: list[str], tmp_path: Path) -> None:
    bag = small(1).write(tmp_path / "in")
    assert cli.main(["bags", "plan", str(bag), str(tmp_path / "out"), *OPTIONS, *options]) == 2


def test_cuts() -> None:
    times = np.array([0, 1, 2, 2, 2, 3, 9]) * 10**9
    assert Cut(2).times(times) == [2 * 10**9, 9 * 10**9]  # never between images of one time
    assert Cut(3).times(times) == [9 * 10**9]
    assert Cut(seconds=3.0).times(times) == [3 * 10**9, 9 * 10**9]
    assert Cut(1).times(times[:0]) == []


def test_what_is_not_of_a_plan_is_not_touched(tmp_path: Path) -> None:
    bag, out = small(1).write(tmp_path / "in"), tmp_path / "out"
    out.mkdir()
    (out / "letter.txt").write_text("dear")
    assert cli.main(["bags", str(bag), str(out), *OPTIONS, "--restart"]) == 1
    assert bytes_of(out) == {"letter.txt": b"dear"}


def test_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(ValueError), whole(tmp_path / "a") as new:
        new.write_text("half")
        raise ValueError
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_processes_that_die_and_results_that_are_not_good(tmp_path: Path) -> None:
    found: dict[int, Any] = {}
    jobs = [(str(tmp_path), number) for number in range(5)]
    run_local(perilous, jobs, 2, 1, bool, lambda job, result: found.setdefault(job[1], result))
    assert isinstance(found.pop(2), RuntimeError)
    assert found == {number: f"done {number}" for number in (0, 1, 3, 4)}


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on(tmp_path: Path) -> None:
    bag, out = small(12).write(tmp_path / "in"), tmp_path / "out"
    command = [sys.executable, "-m", "shadow_tracer.apps.cli", "bags", str(bag), str(out), *OPTIONS]
    command += ["--frames", "1", "--jobs", "1"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    end = time.monotonic() + 120
    while not [*out.glob("in/*.mcap")] and time.monotonic() < end:
        time.sleep(0.01)
    process.kill()
    process.wait()
    time.sleep(1.5)  # its workers see that it is gone
    there = bytes_of(out / "in")
    assert there and "metadata.yaml" not in there
    assert subprocess.run(command, capture_output=True).returncode == 0
    assert log_of(out / "in") == log_of(uncut(bag, tmp_path / "whole.mcap", PARAMETERS))
    assert bytes_of(out / "in").items() >= there.items()


_UNTIL_INTERRUPTED = """
import sys, time
from shadow_tracer.apps import cli
from shadow_tracer.apps.bags.run import Bar

def wait(bar, frames):
    print("a part is there", flush=True)
    time.sleep(120)

Bar.advance = wait
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.mark.slow
def test_an_interrupted_run_ends_at_once_with_130_and_goes_on(tmp_path: Path) -> None:
    bag, out = small(6).write(tmp_path / "in"), tmp_path / "out"
    asked = ["bags", str(bag), str(out), *OPTIONS, "--frames", "1", "--jobs", "2"]
    with subprocess.Popen(
        [sys.executable, "-c", _UNTIL_INTERRUPTED, *asked],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
        # A shell without job control starts what runs in the background with SIGINT ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "a part is there\n"
        process.send_signal(signal.SIGINT)
        assert "interrupted; the same command goes on" in process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert 1 <= len([*out.glob("in/*.mcap")]) <= 2, "of each worker one"
    assert not (out / "in" / "metadata.yaml").exists()
    again = subprocess.run([sys.executable, "-m", "shadow_tracer.apps.cli", *asked], capture_output=True)
    assert again.returncode == 0
    assert log_of(out / "in") == log_of(uncut(bag, tmp_path / "whole.mcap", PARAMETERS))
    assert not [*out.glob("in/.*")]


def test_a_part_of_another_job_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_this_process(monkeypatch)
    bag, out = small(2).write(tmp_path / "in"), tmp_path / "out"
    assert cli.main(["bags", str(bag), str(out), *OPTIONS, "--frames", "1"]) == 0
    first, second = Plan.load(out / "plan.json").jobs()
    report = report_of(first)
    assert isinstance(report, Report) and report.frames == report.images == 1 and len(report.checksum) == 64
    assert play(first).record() == report.record()
    Path(first.part).write_bytes(Path(second.part).read_bytes())
    assert report_of(first) is None
    assert cli.main(["bags", "commit", str(out)]) == 3


def test_help_names_the_steps(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["bags", "--help"])
    assert "--shard 17/200" in capsys.readouterr().out
    assert isinstance(bags._options("run"), argparse.ArgumentParser)
