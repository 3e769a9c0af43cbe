# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer status` beside a node, beside other publishers, and with nobody there."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from shadow_tracer.apps import cli, status

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'shadow_tracer[ros]'")
pytestmark = pytest.mark.ros

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from harness import Rig, reliable  # noqa: E402

NAMES = ("input depth", "input mesh", "transforms", "device", "processing")


def array_of(levels: dict[str, int], node: str = "shadow_tracer") -> DiagnosticArray:
    """A message of a node: five statuses, OK but for those that are named."""
    pairs = [KeyValue(key="rate [Hz]", value="30.0")]
    return DiagnosticArray(
        status=[
            DiagnosticStatus(
                level=bytes([levels.get(name, 0)]), name=f"{node}: {name}", message=f"of {name}", values=pairs
            )
            for name in NAMES
        ]
    )


class Publisher:
    """Publishes messages on /diagnostics again and again, in a thread, until it is closed."""

    def __init__(self, rig: Rig, *messages: DiagnosticArray) -> None:
        self._publisher = rig.friend.create_publisher(DiagnosticArray, "/diagnostics", reliable())
        self._messages = messages
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.wait(0.05):
            for message in self._messages:
                self._publisher.publish(message)

    def close(self) -> None:
        self._done.set()
        self._thread.join()


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig(start=False) as made:
        yield made


def ask(rig: Rig, messages: list[DiagnosticArray], *options: str) -> int:
    publisher = Publisher(rig, *messages)
    try:
        return cli.main(["status", "--timeout", "20", *options])
    finally:
        publisher.close()


OTHER = DiagnosticArray(status=[DiagnosticStatus(name="camera: driver", message="fine", level=b"\x02")])
EMPTY = DiagnosticArray()


@pytest.mark.parametrize(
    ("levels", "code"), [({}, 0), ({"input mesh": 1}, 0), ({"transforms": 2}, 1), ({"device": 3}, 1)], ids=str
)
def test_five_lines_and_the_exit_code(
    rig: Rig, levels: dict[str, int], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever else is on the topic."""
    assert ask(rig, [OTHER, EMPTY, array_of(levels)]) == code
    out, err = capsys.readouterr()
    head, *rest = out.splitlines()
    words = ["OK", "WARN", "ERROR", "STALE"]
    assert head == "shadow_tracer" and err == ""
    assert rest == [f"{words[levels.get(name, 0)]:5} {name:11} of {name}" for name in NAMES]


def test_the_numbers_too_and_nothing_is_cut(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    message = array_of({})
    message.status[0].message = 50 * "long "
    assert ask(rig, [message], "-v") == 0
    out = capsys.readouterr().out
    assert out.count("rate [Hz]: 30.0") == 5 and 50 * "long " in out


def test_a_node_with_several_cameras() -> None:
    """One more status for each further camera; anything else in between is another program's."""

    def named(*names: str) -> DiagnosticArray:
        return DiagnosticArray(status=[DiagnosticStatus(name=f"robot/shadow_tracer: {name}") for name in names])

    cameras = ("input depth front", "input depth rear")
    array = named(*cameras, *NAMES[1:])
    assert status.node_of(array) == "robot/shadow_tracer"
    assert [line.partition(" ")[2].strip() for line in status.lines(array)] == [*cameras, *NAMES[1:]]
    assert status.node_of(named(*NAMES[1:])) == status.node_of(named(*cameras)) == ""
    assert status.node_of(named("battery", *NAMES)) == status.node_of(named()) == ""


def test_one_of_several_nodes(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    messages = [array_of({"device": 2}), array_of({}, "front/shadow_tracer")]
    assert ask(rig, messages, "--node", "/front/shadow_tracer") == 0
    assert capsys.readouterr().out.splitlines()[0] == "front/shadow_tracer"
    assert ask(rig, messages, "--node", "shadow_tracer") == 1


@pytest.mark.slow
def test_nobody_there(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["status", "--timeout", "0.2"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("status: no node: nothing came within 0.2 s; is shadow_node running")
    publisher = Publisher(rig, array_of({}, "front/shadow_tracer"))
    try:
        rig.until(lambda: any(status.node_of(array) for array in rig.reports))
        assert cli.main(["status", "--timeout", "2", "--node", "rear/shadow_tracer"]) == 1
    finally:
        publisher.close()
    assert "; heard: front/shadow_tracer" in capsys.readouterr().err


def test_a_real_node(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    """What it prints is what the node says, and the node's five statuses are the five that are looked for."""
    rig.start()
    rig.until(lambda: rig.reports)
    assert status.node_of(rig.reports[-1]) == "shadow_tracer"
    publisher = Publisher(rig, rig.reports[-1])
    try:
        assert cli.main(["status", "--timeout", "20"]) == int(status.failed(rig.reports[-1]))
    finally:
        publisher.close()
    assert [line.split(" of ")[0][6:17].strip() for line in capsys.readouterr().out.splitlines()[1:]] == list(NAMES)


@pytest.mark.parametrize("seconds", ["0", "-1", "3601", "soon", "nan"])
def test_bad_timeouts(seconds: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(["status", f"--timeout={seconds}"])
    assert caught.value.code == 2
    expected = f"--timeout: expected more than 0 and at most 3600 seconds, got '{seconds}'"
    assert expected in " ".join(capsys.readouterr().err.split())


def test_without_ros(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    real = importlib.util.find_spec

    def absent(name: str, *rest: Any) -> Any:
        return None if name == "rclpy" else real(name, *rest)

    monkeypatch.setattr(importlib.util, "find_spec", absent)
    assert cli.main(["status"]) == 2
    assert capsys.readouterr().err.startswith("status: needs ROS 2")
