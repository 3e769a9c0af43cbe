# SPDX-License-Identifier: Apache-2.0
"""The harness for users: it isolates, waits, says what is wrong, and leaves nothing behind."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from harness import SMALL
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import String

import shadow_tracer
from shadow_tracer import Bias, Camera, PointLight, testing
from shadow_tracer.ros.diagnostics import DEPTH, DEVICE, MESH, OK, WARN
from shadow_tracer.testing import Harness, NotInTime, isolated, plate, wall

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "testing.md"


def child(code: str) -> subprocess.Popen[str]:
    """A Python with this package that runs the code; its stdout is read line by line."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )


@pytest.fixture(scope="module")
def shared() -> Iterator[Harness]:
    """A node in this process, for tests that do not change it."""
    with Harness(SMALL) as made:
        yield made


# The page


def block() -> str:
    (found,) = re.findall(r"^```python test\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return found


@pytest.mark.slow
def test_the_test_on_the_page_passes_word_for_word(tmp_path: Path) -> None:
    assert len([line for line in block().splitlines() if line.strip()]) == 20, "it says twenty lines"
    (tmp_path / "test_lit_share.py").write_text(block(), encoding="utf-8")
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_lit_share.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout + done.stderr


def test_the_table_on_the_page_has_every_public_name() -> None:
    table = PAGE.read_text(encoding="utf-8").partition("| Name | What it is |\n|---|---|\n")[2].partition("\n\n")[0]
    names = [name for row in table.splitlines() for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(names) == sorted(testing.__all__)
    methods = re.findall(r"`(\w+)(?:\(.*?\))?`", PAGE.read_text(encoding="utf-8").partition("| To | Call |")[2])
    assert {"trace", "until", "add"} < {name for name in methods if hasattr(Harness, name)}


def test_it_needs_no_pytest_and_says_what_it_needs() -> None:
    code = "import sys, shadow_tracer.testing; print('pytest' in sys.modules)"
    assert child(code).communicate(timeout=60)[0] == "False\n"
    code = "import sys; sys.modules['rclpy'] = None; import shadow_tracer.testing"
    assert (
        "shadow_tracer.testing needs rclpy: pip install 'shadow_tracer[ros]'" in child(code).communicate(timeout=60)[1]
    )


# What it sends and hears


def expected(vertices: np.ndarray, triangles: np.ndarray, lamp: tuple[float, ...] = (0.5, -0.5, 0.0)) -> np.ndarray:
    """The library's mask for a node with the lamp there."""
    tracer = shadow_tracer.ShadowTracer(device="cpu", bounds=shadow_tracer.Bounds(max_triangles=100, max_rays=5000))
    tracer.scene.put("mesh", vertices, triangles)
    camera = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    return tracer.trace(wall(), camera, [PointLight("lamp", lamp)], bias=Bias(0.02, 0.003, 0.6)).mask()


@pytest.mark.slow
@pytest.mark.parametrize("process", [False, True], ids=["in this process", "in another"])
def test_both_kinds_of_node_do_the_same(process: bool) -> None:
    with Harness(SMALL, process=process, namespace="/front") as harness:
        assert (harness.process is not None) == process and (harness.node is None) == process
        masks = harness.listen_to_light("lamp")
        harness.send_mesh(*plate())
        np.testing.assert_array_equal(harness.trace(wall()), expected(*plate()))
        assert harness.set_parameters({"lights.lamp.position": [0.2, -0.5, 0.0]}) == ""
        np.testing.assert_array_equal(harness.trace(wall()), expected(*plate(), lamp=(0.2, -0.5, 0.0)))
        moved = expected(*plate(), lamp=(0.1, 0.3, 0.2))

        def lamp_has_moved() -> bool:
            # Each time: whoever listens may not yet hear a publisher that already knows of it.
            harness.send_light_pose("lamp", (0.1, 0.3, 0.2))
            return np.array_equal(harness.trace(wall()), moved)

        harness.until(lamp_has_moved, what="the lamp is moved")
        assert harness.set_parameters({"device": "cpu"}).startswith("device is read-only")
        stamp = harness.send_frame(wall())
        assert float(harness.timing_of(stamp)["total [ms]"]) > 0.0
        np.testing.assert_array_equal(harness.mask_of(stamp, "lamp"), harness.mask_of(stamp))
        assert len(masks) >= 4
        assert harness.wait_status(MESH, OK).name == f"front/shadow_tracer: {MESH}"
        assert harness.value(DEVICE, "device") == "cpu"
        harness.forget()
        assert not masks and harness.last_statuses() == "no diagnostics"


def test_a_camera_and_its_pose() -> None:
    camera = Camera(32, 24, 40.0, 41.0, 15.0, 12.0)
    with Harness({**SMALL, "pose_source": "topic", "lights.lamp.frame": "camera"}) as harness:
        harness.send_pose((0.2, 0.0, 0.0))
        stamp = harness.send_frame(wall(32, 24), camera=camera)
        assert (harness.mask_of(stamp)[1:] == 255).all()
        assert harness.until(lambda: harness.infos)[-1].k[4] == 41.0


def test_a_node_that_is_started_later_has_what_was_given() -> None:
    given = {**SMALL, "bias.constant": 0.25, "bias.quadratic": 0.5}
    with Harness(given, arguments=["-r", "mesh:=first"], start=False) as harness:
        node = harness.start({"bias.quadratic": 0.0}, ["-r", "query:=second"], wait=False)
        assert node.get_parameter("bias.constant").value == 0.25
        assert node.get_parameter("bias.quadratic").value == 0.0
        assert {"/first", "/second"} <= {subscription.topic_name for subscription in node.subscriptions}


def test_each_message_is_heard_once(shared: Harness) -> None:
    assert shared.listen_to_light("lamp") is shared.listen_to_light("lamp")
    before = len(shared.masks["lamp"])
    stamp = shared.send_frame(wall())
    shared.mask_of(stamp)
    shared.mask_of(stamp, "lamp")
    assert len(shared.masks["lamp"]) == before + 1
    with pytest.raises(NotInTime):
        shared.collect(String, "later", timeout=0.05)
    publisher = shared.friend.create_publisher(String, "later", 1)
    heard = shared.collect(String, "later")
    publisher.publish(String(data="once"))
    assert [message.data for message in shared.until(lambda: heard)] == ["once"]


def test_others_on_diagnostics_are_not_the_node(shared: Harness) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    shared.wait_status(DEVICE, OK)
    other = DiagnosticStatus(name=f"rear/shadow_tracer: {DEVICE}", message="another node", level=WARN)
    shared.reports.append(DiagnosticArray(status=[other]))
    found = shared.status(DEVICE)
    assert found is not None and found.level == OK and "another node" not in shared.last_statuses()


def test_your_own_node_runs_while_the_harness_waits() -> None:
    class Echo(Node):
        def __init__(self, **keywords: Context) -> None:
            super().__init__("echo", **keywords)
            self.out = self.create_publisher(String, "out", 10)
            self.create_subscription(String, "in", self.out.publish, 10)

    with Harness(start=False) as harness:
        harness.add(Echo(context=harness.context))
        heard = harness.collect(String, "out")
        assert heard is harness.collect(String, "out")
        harness.publisher(String, "in").publish(String(data="hello"))
        assert harness.until(lambda: heard)[0].data == "hello"
        with isolated() as domain:
            assert domain == harness.domain


# What it says when something does not come, or is wrong


def test_what_does_not_come_is_said_with_what_came_last(shared: Harness) -> None:
    stamp = shared.send_frame(wall())
    shared.mask_of(stamp)
    shared.wait_status(DEPTH, OK)
    with pytest.raises(NotInTime) as caught:
        shared.mask_of(stamp + 1, timeout=0.05)
    text = str(caught.value)
    assert text.startswith(f"not within 0.05 s: a mask with stamp {stamp + 1} ns; ")
    assert f"the last with stamp {stamp} ns" in text and f"shadow_tracer: {DEPTH} b'\\x00'" in text
    with pytest.raises(NotInTime, match=r"not within 0.05 s: input mesh says b'\\x00' 'a thousand'; .*no mesh"):
        shared.wait_status(MESH, OK, "a thousand", timeout=0.05)
    with pytest.raises(NotInTime, match="not within 0.05 s: nothing/at/all is published"):
        shared.collect(String, "nothing/at/all", timeout=0.05)
    with pytest.raises(NotInTime, match="not within 0.05 s: somebody listens to nothing"):
        shared.publisher(String, "nothing", timeout=0.05)


def test_a_client_that_never_finds_its_service_is_replaced(shared: Harness, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one in 300 does that is made while the service is being discovered."""
    made: list[Client] = []
    create = shared.friend.create_client

    def blind_at_first(kind: type, service: str) -> Client:
        made.append(create(kind, service))
        if len(made) < 3:
            monkeypatch.setattr(made[-1], "service_is_ready", lambda: False)
        return made[-1]

    monkeypatch.setattr(shared.friend, "create_client", blind_at_first)
    monkeypatch.setattr(testing.friend, "_PATIENCE", 0.05)
    assert shared.call(GetParameters, "shadow_tracer/get_parameters").values == []
    assert shared.client(GetParameters, "shadow_tracer/get_parameters") is made[-1] and len(made) == 3
    assert made[-1] in shared.friend.clients and made[0] not in shared.friend.clients
    with pytest.raises(NotInTime, match="not within 0.2 s: nowhere is there"):
        shared.client(GetParameters, "nowhere", timeout=0.2)
    assert len(made) > 4, "and it is looked for again and again"


def test_arguments_that_are_wrong_are_named(shared: Harness) -> None:
    with pytest.raises(
        ValueError, match=r"depth: expected a \(H, W\) array of float32 .* got float64 of shape \(4, 4\)"
    ):
        shared.send_frame(np.zeros((4, 4)))
    with pytest.raises(ValueError, match=r"depth: expected a \(H, W\) array .* got float32 of shape \(4, 4, 1\)"):
        shared.send_frame(np.zeros((4, 4, 1), np.float32))
    with pytest.raises(ValueError, match="depth: expected a .* array .* got list"):
        shared.send_frame([[1.0]])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"depth: expected shape \(24, 32\) of the camera, got \(48, 64\)"):
        shared.send_frame(wall(), camera=Camera(32, 24, 40.0, 40.0, 15.5, 11.5))
    with pytest.raises(ValueError, match=r"light: expected one of \[.*\] \(see listen_to_light\), got 'sun'"):
        shared.mask_of(1, "sun")
    with pytest.raises(ValueError, match="triangles: expected shape"):
        shared.send_mesh(np.zeros((3, 3)), np.zeros(3))
    for timeout in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="timeout: expected seconds above 0, got"):
            shared.until(lambda: True, timeout)
    with pytest.raises(RuntimeError, match="start: the node has been started already"):
        shared.start()
    with (
        Harness(start=False) as other,
        pytest.raises(ValueError, match="node: expected one that was made with context"),
    ):
        shared.add(other.friend)


def test_values_as_the_command_line_takes_them() -> None:
    from shadow_tracer.testing.process import _yaml

    assert [_yaml(value) for value in (True, 1, 1e-5, 0.5, "cpu", [0.5, 1e-7], ["a", "b"], np.float32(0.5))] == [
        "true", "1", "0.00001", "0.5", "cpu", "[0.5, 0.0000001]", "[a, b]", "0.5",
    ]  # fmt: skip
