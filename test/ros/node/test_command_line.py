# SPDX-License-Identifier: Apache-2.0
"""The command line of the nodes: nothing is silently ignored, and what ros2 run and launch pass still works."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from shadow_tracer.ros.node.command_line import answer, outside, usage

ROOT = Path(__file__).parents[3]
PROGRAMS = ("shadow_node", "shadow_lifecycle_node")


@pytest.mark.parametrize(
    "words",
    [
        "",
        "--ros-args",
        "--ros-args -p pipeline:=auto --params-file x.yaml -r __ns:=/front --log-level debug",
        "--ros-args -r a:=b --",
        "--ros-args -r a:=b -- --ros-args -p c:=d",
        "--ros-args --log-level info --ros-args -r __node:=shade -p use_sim_time:=true",
        "--",
    ],
)
def test_what_ros_passes_starts_the_node(words: str) -> None:
    assert answer("shadow_node", words.split()) is None


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("word", ["-h", "--help"])
def test_help_says_what_there_is(program: str, word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert answer(program, [word]) == 0 == answer(program, ["--ros-args", "-p", "a:=b", "--", word])
    out, err = capsys.readouterr()
    assert out == 2 * f"{usage(program)}\n" and err == ""
    assert out.startswith(f"usage: {program} ") and "--ros-args --params-file my.yaml" in out
    assert max(map(len, out.splitlines())) <= 120


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            "--params-file my.yaml",
            "got --params-file my.yaml; for ROS it comes after --ros-args: {} --ros-args --params-f",
        ),
        (
            "-p pipeline:=auto",
            "got -p pipeline:=auto; for ROS it comes after --ros-args: {} --ros-args -p pipeline:=auto",
        ),
        ("-p=pipeline:=auto", "for ROS it comes after --ros-args"),
        ("use_sim_time:=true", "got use_sim_time:=true; for ROS it comes after --ros-args"),
        ("--verbose", "got --verbose\n"),
        ("--ros-args -p a:=b -- more 'words", "got more ''\"'\"'words'\n"),
    ],
)
@pytest.mark.parametrize("program", PROGRAMS)
def test_what_nobody_would_read_is_refused(
    program: str, words: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert answer(program, words.split()) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(f"{program}: expected nothing but --help and --ros-args ..., got ")
    assert text.format(program) in err


def test_what_is_outside() -> None:
    assert outside(["a", "--ros-args", "b", "--", "c", "--ros-args", "d"]) == ["a", "c"]


@pytest.mark.parametrize("module", ["main", "lifecycle_main"])
def test_the_programs_answer_without_ros(module: str) -> None:
    code = f"import sys; from shadow_tracer.ros.node.process import {module}; sys.exit({module}())"
    blocked = "import sys; sys.modules['rclpy'] = None; " + code
    for words, expected in ((["--help"], 0), (["--params-file", "x.yaml"], 2)):
        run = subprocess.run([sys.executable, "-c", blocked, *words], cwd=ROOT, capture_output=True, text=True)
        assert run.returncode == expected, run.stderr
        assert (run.stdout == "") == bool(expected) and (run.stderr == "") == (not expected)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda s: s.name)
@pytest.mark.slow
def test_a_node_in_the_background_of_a_script_hears_signals(number: signal.Signals, tmp_path: Path) -> None:
    """`sh -c 'node & ...'`: the shell ignores SIGINT for it, and children inherit that."""
    script = f"""
trap '' {number.name[3:]}
"{sys.executable}" -m shadow_tracer.ros --ros-args -p device:=cpu -p bounds.max_rays:=1000 > "$1" 2> "$2" &
node=$!
while ! grep -q Ready "$1"; do kill -0 $node || exit 99; sleep 0.05; done
kill -{number.name[3:]} $node
wait $node
"""
    out, err = tmp_path / "out", tmp_path / "err"
    run = subprocess.run(["sh", "-c", script, "sh", out, err], cwd=ROOT, timeout=120, capture_output=True)
    assert (run.returncode, err.read_text()) == (0, ""), out.read_text()
