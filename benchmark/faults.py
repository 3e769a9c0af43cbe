# SPDX-License-Identifier: Apache-2.0
"""What goes wrong around a node, made to go wrong: each scenario ends with masks that have the library's very bits.

Nodes are processes of their own. A scenario either returns a sentence about what it saw, or fails.
"""

from __future__ import annotations

import argparse
import array
import functools
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from compressed_images import damaged, png_of
from harness import FOCAL, NodeProcess, Rig, info_msg, nanoseconds, plate, reliable, wall
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.qos import DurabilityPolicy
from visualization_msgs.msg import MarkerArray

from shadow_tracer import Bias, Bounds, Camera, PointLight, ShadowTracer
from shadow_tracer.ros.diagnostics import DEPTH, ERROR, MESH, PROCESSING, WARN
from shadow_tracer.ros.wire.cdr import encode_mesh

UNKNOWN = 77
PATIENCE = 20.0  # s
SHOW_UNKNOWN = {"mask.unknown_value": UNKNOWN}
STOPS = (signal.SIGINT, signal.SIGTERM)
_SHARED_MEMORY = Path("/dev/shm")


@functools.cache
def _tracer() -> ShadowTracer:
    return ShadowTracer(device="cpu", bounds=Bounds(max_triangles=4096, max_rays=128 * 96, queue_capacity=16384))


def expected(
    vertices: np.ndarray, triangles: np.ndarray, depth: np.ndarray | None = None, camera: Camera | None = None
) -> np.ndarray:
    """The library's mask for a node without parameters but SHOW_UNKNOWN."""
    depth = wall() if depth is None else depth
    height, width = depth.shape
    camera = camera or Camera(width, height, FOCAL, FOCAL, (width - 1) / 2, (height - 1) / 2)
    tracer = _tracer()
    tracer.scene.put("mesh", vertices, triangles)
    frame = tracer.trace(depth, camera, [PointLight("lamp", (0.5, -0.5, 0.0))], bias=Bias(0.02, 0.003, 0.6))
    return frame.mask(unknown=UNKNOWN)


def patches(count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Small triangles between camera and wall."""
    rng = np.random.default_rng(seed)
    middle = np.stack([rng.uniform(-0.4, 0.4, count), rng.uniform(-0.3, 0.3, count), rng.uniform(0.8, 1.4, count)], -1)
    corners = middle[:, None] + rng.uniform(-0.08, 0.08, (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


@contextmanager
def node_and_friend(
    parameters: dict[str, Any] | None = None, *, mesh: Any = None, namespace: str = "", **keywords: Any
) -> Iterator[tuple[NodeProcess, Rig]]:
    """A node process that is ready, and a friend that hears it, a rig with the ``keywords``. A ``mesh`` is published
    before the node exists."""
    arguments = ["-r", f"__ns:={namespace}"] if namespace else []
    with Rig(start=False, namespace=namespace, **keywords) as rig:
        if mesh is not None:
            rig.mesh.publish(encode_mesh(*mesh))
        with NodeProcess({**SHOW_UNKNOWN, **(parameters or {})}, arguments=arguments) as process:
            process.wait_for("Ready")
            rig.connected()
            first_mask(rig)
            yield process, rig
            check_end(process, signal.SIGTERM)


def check_end(process: NodeProcess, number: signal.Signals) -> None:
    """End a node; it must do so cleanly."""
    code, errors = process.stop(number)
    assert (code, errors) == (0, ""), f"exit code {code}, on stderr: {errors[-2000:]}"


def first_mask(rig: Rig) -> None:
    """Send frames until one is answered. A best effort subscription can miss what is sent while it is being found."""
    for _ in range(100):
        stamp = rig.send_frame(wall())
        with suppress(AssertionError):
            rig.mask_of(stamp, timeout=0.2)
            return
    raise AssertionError(f"no frame is answered; {rig.last_statuses()}")


def trace_until(rig: Rig, depth: np.ndarray, mask: np.ndarray, what: str) -> int:
    """Send frames until the mask is the expected one: messages of other topics have arrived by then.

    The limit is a time, not a number of frames: a subscription follows its publishers once a second.
    """
    deadline, attempt = time.monotonic() + PATIENCE, 0
    while time.monotonic() < deadline:
        attempt += 1
        if np.array_equal(rig.trace(depth), mask):
            return attempt
    raise AssertionError(f"{attempt} frames in {PATIENCE:g} s, none of them with {what}; {rig.last_statuses()}")


def has_faults(rig: Rig) -> bool:
    """Whether the node has counted an exception that should not have happened."""
    rig.reports.clear()
    rig.until(lambda: rig.value(PROCESSING, "faults"), what="/diagnostics")
    return rig.value(PROCESSING, "faults") != "0"


# Publishers and listeners that come and go


class Player:
    """A process that publishes a wall, its camera_info and a plate, 30 times a second, until it is killed."""

    def __init__(self, x: float) -> None:
        # It inherits the environment of who starts it, and so the domain to join.
        command = [sys.executable, str(Path(__file__).resolve()), "--play", str(x)]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL)

    def kill(self) -> None:
        """As the kernel does when memory runs out."""
        self._process.kill()
        self._process.wait()

    def __enter__(self) -> Player:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()


def play(x: float) -> None:
    """What a :class:`Player` does."""
    with Rig(start=False, domain=int(os.environ["ROS_DOMAIN_ID"])) as rig:
        while True:
            rig.mesh.publish(encode_mesh(*plate(x=x)))
            rig.send_frame(wall(), time.time_ns())
            rig.executor.spin_once(timeout_sec=0.0)
            time.sleep(1 / 30)


def publisher_killed_and_restarted(places: Sequence[float] = (0.0, 0.1, -0.1), silence: bool = True) -> str:
    """SIGKILL to who publishes everything; then another one, whose plate is at another place.

    Args:
        silence: wait until the node misses the first one, which takes seconds.
    """
    with ExitStack() as stack:
        rig = stack.enter_context(Rig(start=False))
        process = stack.enter_context(NodeProcess(SHOW_UNKNOWN))
        process.wait_for("Ready")
        for number, x in enumerate(places):
            mask = expected(*plate(x=x))
            rig.masks[""].clear()
            with Player(x) as player:
                rig.until(lambda mask=mask: _last_mask_is(rig, mask), what=f"masks of publisher {number}")
                player.kill()
            if silence and number == 0:
                rig.wait_status(DEPTH, WARN, "no depth image for")
        assert not has_faults(rig)
        check_end(process, signal.SIGINT)
    return f"masks of each of {len(places)} publishers, killed one after the other"


def _last_mask_is(rig: Rig, mask: np.ndarray) -> bool:
    if not rig.masks[""]:
        return False
    return bytes(rig.masks[""][-1].data) == mask.tobytes()


def late_joiners() -> str:
    """A mesh that was there before the node; a listener and a viewer that come after it, and when nothing changes."""
    mesh = plate(x=0.05)
    seen: list[MarkerArray] = []
    with node_and_friend(latched=True, mesh=mesh) as (_, rig):
        attempts = trace_until(rig, wall(), expected(*mesh), "the mesh that was published first")
        with Rig(start=False) as late:
            late.connected()
            profile = reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
            late.friend.create_subscription(MarkerArray, "shadow_tracer/scene_markers", seen.append, profile)
            stamp = rig.send_frame(wall())
            np.testing.assert_array_equal(late.mask_of(stamp), expected(*mesh))
            late.until(lambda: seen and [marker.ns for marker in seen[-1].markers] == ["", "mesh"], what="the mesh")
    return f"latched mesh in force by frame {attempts}; a late listener gets the next mask, a late viewer the mesh"


# Time


def stamps_jump_back() -> str:
    """A bag that starts again."""
    mask = expected(*plate())
    with node_and_friend() as (_, rig):
        rig.mesh.publish(encode_mesh(*plate()))
        trace_until(rig, wall(), mask, "the mesh")
        for loop in range(1, 4):
            rig.stamp -= 500_000_000_000
            trace_until(rig, wall(), mask, "the mesh after a jump")
            rig.until(
                lambda loop=loop: rig.value(PROCESSING, "time jumps back") == str(loop), what="the jump is counted"
            )
        assert not has_faults(rig)
    return "3 jumps of 500 s, each counted, masks go on"


def sim_time_jumps_back() -> str:
    """A simulator that is reset: /clock goes back, again and again."""
    mask = expected(*plate())
    with node_and_friend({"use_sim_time": True, "mesh.max_age": 50.0}) as (_, rig):
        for loop in range(3):
            rig.publish_clock(1000.0)
            rig.mesh.publish(encode_mesh(*plate()))
            trace_until(rig, wall(), mask, "the mesh")
            rig.publish_clock(1040.0)
            rig.until(lambda: _age(rig) > 39.0, what="the mesh is 40 s old")
            rig.publish_clock(3.0)
            rig.until(lambda: _age(rig) < 1.0, what="ages start again")
            jumps = int(rig.value(PROCESSING, "time jumps back"))
            assert jumps > loop, f"{jumps} jumps counted in loop {loop}"
            trace_until(rig, wall(), mask, "the mesh after a jump")
        assert not has_faults(rig)
    return "3 resets of /clock, ages start again, masks go on"


def _age(rig: Rig) -> float:
    """Age of the mesh [s], NaN if there is none."""
    text = rig.value(MESH, "age [s]")
    return float(text) if text not in ("", "-") else float("nan")


# Bounds


def mesh_larger_than_bounds() -> str:
    """Refused whole, and the last good one stays."""
    good = patches(50)
    with node_and_friend({"bounds.max_triangles": 50}) as (_, rig):
        rig.mesh.publish(encode_mesh(*good))
        trace_until(rig, wall(), expected(*good), "50 triangles")
        for count in (51, 5000):
            rig.mesh.publish(encode_mesh(*patches(count, seed=2)))
            rig.wait_status(MESH, ERROR, f"{count} triangles")
            assert "bounds.max_triangles" in rig.wait_status(MESH, ERROR).message
            np.testing.assert_array_equal(rig.trace(wall()), expected(*good))
        other = patches(50, seed=3)
        rig.mesh.publish(encode_mesh(*other))
        trace_until(rig, wall(), expected(*other), "the next good mesh")
        assert not has_faults(rig)
    return "51 and 5000 triangles refused at a bound of 50, the last mesh stays"


def lens_misread() -> str:
    """camera_info with a distortion that cannot be undone: unknown masks and a reason, until one that can comes."""
    mesh, model, d = patches(50), "equidistant", [0.3, 0.1, -0.05, 0.02]
    height, width = wall().shape
    lens = Camera.distorted(width, height, FOCAL, FOCAL, (width - 1) / 2, (height - 1) / 2, model, d)
    mask = expected(*mesh, camera=lens)
    assert (mask != expected(*mesh)).any()
    with node_and_friend({"distortion": "apply"}) as (_, rig):
        rig.mesh.publish(encode_mesh(*mesh))
        trace_until(rig, wall(), expected(*mesh), "no distortion")
        for name, values in (("fisheye", d), (model, d[:3]), (model, [float("nan")] * 4), (model, [-9.0, 0, 0, 0])):
            assert (_through(rig, name, values) == UNKNOWN).all()
            rig.wait_status(DEPTH, ERROR, "camera_info.d")
            np.testing.assert_array_equal(_through(rig, model, d), mask)
        assert not has_faults(rig)
    return "four that cannot be undone refused by name, and the next good one has the library's mask"


def _through(rig: Rig, model: str, d: Sequence[float]) -> np.ndarray:
    """The mask of a wall seen through a lens."""
    stamp, (height, width) = rig.next_stamp(), wall().shape
    info = info_msg(width, height, stamp)
    info.distortion_model, info.d = model, d
    rig.info.publish(info)
    rig.depth.publish(rig.depth_msg(wall(), stamp))
    return rig.mask_of(stamp)


def bounds_of_one() -> str:
    """Everything may be one: a triangle, a pixel, a light, an entry."""
    small = np.full((12, 16), 2.0, np.float32)
    ones = {f"bounds.{name}": 1 for name in ("max_triangles", "max_lights", "queue_capacity", "grid_entries")}
    one = (np.array([(0.2, -0.3, 1.0), (0.3, -0.3, 1.0), (0.25, -0.18, 1.0)]), np.array([(0, 1, 2)]))
    with node_and_friend({**ones, "bounds.max_rays": 192}) as (_, rig):
        rig.mesh.publish(encode_mesh(*one))
        mask = expected(*one, small)
        assert (mask == 0).any() and (mask == 255).any()
        trace_until(rig, small, mask, "one triangle")
        rig.mesh.publish(encode_mesh(*plate()))
        rig.wait_status(MESH, ERROR, "bounds.max_triangles")
        np.testing.assert_array_equal(rig.trace(small), mask)
        assert (rig.trace(wall()) == UNKNOWN).all()
        rig.wait_status(PROCESSING, ERROR, "bounds.max_rays")
        assert not has_faults(rig)
    with node_and_friend({**ones, "bounds.max_rays": 1}) as (_, rig):
        assert rig.trace(np.full((1, 1), 2.0, np.float32)).tolist() == [[255]]
        assert (rig.trace(np.full((1, 2), 2.0, np.float32)) == UNKNOWN).all()
        assert not has_faults(rig)
    many = patches(400)
    mask = expected(*many, small)
    assert (mask == 0).any() and (mask == 255).any()
    queues = {"bounds.queue_capacity": 1, "bounds.grid_entries": 1}
    with node_and_friend({**queues, "bounds.max_triangles": 400}) as (_, rig):
        rig.mesh.publish(encode_mesh(*many))
        trace_until(rig, small, mask, "400 triangles, entry by entry")
    return "one triangle, one ray, one light, one queue entry: same masks, the rest refused by name"


# Depth images that are packed, and damaged


def damaged_compressed_depth() -> str:
    """Each is refused by name; the masks before and after are right, and no bomb takes memory."""
    depth = np.nan_to_num(wall() * 1000).astype(np.uint16)
    mask = expected(*plate(), depth)
    with node_and_friend({"depth_image_transport": "compressedDepth"}, codec="rvl") as (process, rig):
        rig.mesh.publish(encode_mesh(*plate()))
        trace_until(rig, depth, mask, "the mesh")
        before = _resident(process)
        rig.forget()
        count = 0
        for count, (what, format, data, refusal) in enumerate(damaged(depth), 1):
            rig.codec = "png" if count % 2 else "rvl"
            heard = len(rig.masks[""])
            msg = rig.depth_msg(depth, rig.next_stamp())
            msg.format, msg.data = format, array.array("B", data)
            rig.info.publish(info_msg(64, 48, rig.stamp))
            rig.depth.publish(msg)
            rig.until(lambda number=str(count): rig.value(DEPTH, "refused") == number, what=f"{what} is refused")
            said = rig.value(DEPTH, "last refusal")
            assert said.startswith(refusal), f"{what}: {said}"
            np.testing.assert_array_equal(rig.trace(depth), mask)
            assert len(rig.masks[""]) == heard + 1, f"{what} has a mask"
        rig.wait_status(DEPTH, ERROR, "image refused, format: expected")
        unknown = _whole_but_empty(rig)
        grown = _resident(process, largest=True) - before
        assert grown < 64 * 2**20, f"{grown / 2**20:.0f} MiB were taken for a while"
        np.testing.assert_array_equal(rig.trace(depth), mask)
        assert not has_faults(rig)
    return (
        f"{count} refused by name, {unknown} of nothing unknown, masks right after each, peak {grown / 2**20:.0f} MiB"
    )


def _whole_but_empty(rig: Rig) -> int:
    """Images that can be read and say nothing: no pixel is measured, or camera_info is of another size."""
    for body in (png_of(64, 48, bytes(200_000_000)), png_of(64, 48, bytes(48 * (1 + 2 * 64)))):
        msg = rig.depth_msg(wall(), rig.next_stamp())
        msg.format, msg.data = "16UC1; compressedDepth png", array.array("B", bytes(12) + body)
        rig.info.publish(info_msg(64, 48, rig.stamp))
        rig.depth.publish(msg)
        assert (rig.mask_of(rig.stamp) == UNKNOWN).all()
    rig.info.publish(info_msg(64, 48, rig.next_stamp()))
    rig.depth.publish(rig.depth_msg(wall(32, 24), rig.stamp))
    assert (rig.mask_of(rig.stamp) == UNKNOWN).all()
    return 3


def _resident(process: NodeProcess, largest: bool = False) -> int:
    """Resident memory [B]: that of now, from which on the largest one is counted, or the largest since then."""
    folder = Path(f"/proc/{process.pid}")
    if not largest:
        (folder / "clear_refs").write_text("5")
    name = "VmHWM" if largest else "VmRSS"
    return 1024 * int(re.search(rf"^{name}:\s*(\d+) kB$", (folder / "status").read_text(), re.MULTILINE)[1])


# Several nodes


def several_cameras(count: int = 4) -> str:
    """As many nodes, by namespace: each sees its own frames, mesh and parameters, and nothing of the others."""
    with ExitStack() as stack:
        pairs = []
        for number in range(count):
            namespace = f"/camera_{number}"
            rig = stack.enter_context(Rig(start=False, namespace=namespace))
            process = stack.enter_context(NodeProcess(SHOW_UNKNOWN, arguments=["-r", f"__ns:={namespace}"]))
            rig.stamp += number * 1_000_000_000_000  # nobody else has these stamps
            pairs.append((process, rig))
        for process, rig in pairs:
            process.wait_for("Ready")
            rig.connected()
            first_mask(rig)
        meshes = [plate(x=0.06 * number - 0.1) for number in range(count)]
        for (_, rig), mesh in zip(pairs, meshes, strict=True):
            rig.mesh.publish(encode_mesh(*mesh))
        sent: list[set[int]] = [set() for _ in pairs]
        for _ in range(3):
            for number, (_, rig) in enumerate(pairs):
                trace_until(rig, wall(), expected(*meshes[number]), f"the mesh of camera {number}")
                sent[number] |= {nanoseconds(message.header.stamp) for message in rig.masks[""]}
        for number, (process, rig) in enumerate(pairs):
            first = 1_000_000_000_000 * (1 + number)
            assert all(first < stamp < first + 10**12 for stamp in sent[number]), "a mask of another camera"
            assert not has_faults(rig)
            check_end(process, STOPS[number % 2])
    return f"{count} nodes in {count} namespaces, each with its own masks"


def two_nodes() -> str:
    """Two nodes in namespaces; one ends, the other goes on."""
    mask = expected(*plate())
    with node_and_friend(namespace="/front") as (_, front):
        with node_and_friend(namespace="/rear") as (_, rear):
            rear.mesh.publish(encode_mesh(*plate()))
            trace_until(rear, wall(), mask, "the mesh of /rear")
            assert (front.trace(wall())[1:] == 255).all(), "/front sees the mesh of /rear"
        front.mesh.publish(encode_mesh(*plate()))
        trace_until(front, wall(), mask, "the mesh of /front")
    return "no message crosses; /front goes on after /rear has ended"


# Signals


def _segments(pid: int) -> set[str]:
    """Files of shared memory that a process has mapped."""
    try:
        text = Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return set()
    return set(re.findall(rf"{_SHARED_MEMORY}/(\S+)", text))


def _used_by_somebody() -> set[str]:
    return set().union(*(_segments(int(entry)) for entry in os.listdir("/proc") if entry.isdigit()))


def _children(pid: int) -> set[int]:
    found = set()
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                fields = Path(f"/proc/{entry}/stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == pid:
                found.add(int(entry))
    return found


def wait_for_handlers(process: NodeProcess) -> float:
    """Until the program handles SIGTERM itself; how long that takes [s]. Nobody can answer a signal before that."""
    begin = time.monotonic()
    while process.running:
        line = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{process.pid}/status").read_text())
        if line and int(line[1], 16) >> (signal.SIGTERM - 1) & 1:
            return time.monotonic() - begin
        time.sleep(0.001)
    raise AssertionError(f"the node ended by itself: {process.err}")


def stop_once(rig: Rig, rng: random.Random, number: signal.Signals, latest: float) -> tuple[float, float]:
    """Start a node amid traffic and stop it at a random moment within ``latest`` seconds after its handlers are there.

    Returns:
        Seconds until the handlers were in place, and from the signal to the end.
    """
    before = set(os.listdir(_SHARED_MEMORY))
    with NodeProcess() as process:
        handled = wait_for_handlers(process)
        moment = time.monotonic() + rng.uniform(0.0, latest)
        mapped: set[str] = set()
        while time.monotonic() < moment:
            rig.mesh.publish(encode_mesh(*plate()))
            rig.send_frame(wall())
            rig.executor.spin_once(timeout_sec=0.005)
            mapped |= _segments(process.pid)
        children = _children(process.pid)
        sent = time.monotonic()
        process.send(number)
        mapped |= _segments(process.pid)
        code, errors = process.wait(30.0)
        took = time.monotonic() - sent
        what = f"{number.name} after {latest:.2f} s"
        assert (code, errors) == (0, ""), f"{what}: exit code {code}, on stderr: {errors[-2000:]}"
    orphans = {child for child in children if Path(f"/proc/{child}").exists()}
    assert not orphans, f"{what}: orphans {orphans}"
    rig.until(lambda: not _left_over(mapped - before), 5.0, f"{what}: shared memory is gone")
    rig.forget()
    return handled, took


def _left_over(ours: set[str]) -> set[str]:
    present = ours & set(os.listdir(_SHARED_MEMORY))
    return present - _used_by_somebody() if present else present


def signals_at_random_times(count: int = 100, seed: int = 1, latest: float = 0.0) -> str:
    """SIGINT and SIGTERM in turn: while importing, while loading kernels, amid frames.

    Args:
        latest: seconds within which they come; 0: half as long again as a start takes.
    """
    rng = random.Random(seed)
    with Rig(start=False) as rig:
        if not latest:
            with NodeProcess() as process:
                wait_for_handlers(process)
                begin = time.monotonic()
                process.wait_for("Ready")
                latest = 1.5 * (time.monotonic() - begin)
                check_end(process, signal.SIGTERM)
        times = [stop_once(rig, rng, STOPS[n % 2], latest) for n in range(count)]
    handled, took = np.array(times).T
    return (
        f"{count} signals within {latest:.1f} s: exit code 0, nothing on stderr, no orphan, no shared memory left; "
        f"ended after {np.median(took):.2f} s (slowest {took.max():.2f} s); "
        f"handlers in place {np.median(handled):.2f} s after the start"
    )


SCENARIOS: dict[str, Callable[..., str]] = {
    function.__name__.replace("_", " "): function
    for function in (
        publisher_killed_and_restarted,
        late_joiners,
        stamps_jump_back,
        sim_time_jumps_back,
        mesh_larger_than_bounds,
        lens_misread,
        bounds_of_one,
        damaged_compressed_depth,
        two_nodes,
        several_cameras,
        signals_at_random_times,
    )
}


def main() -> int:
    """Run the scenarios, print a table, and say by the exit code whether all went well."""
    from benchmark.report import finish

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="*", default=list(SCENARIOS), choices=list(SCENARIOS))
    parser.add_argument("--signals", type=int, default=100, help="how many")
    parser.add_argument("--json", help="file to write")
    parser.add_argument("--play", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.play is not None:
        play(options.play)
    set_logger_level("rcl.logging_rosout", LoggingSeverity.ERROR)  # it minds that several friends have one name
    rows, failed = [], False
    for name in options.scenarios:
        begin = time.monotonic()
        arguments = {"count": options.signals} if name.startswith("signals") else {}
        try:
            outcome = SCENARIOS[name](**arguments)
        except Exception as error:
            outcome, failed = f"FAILED: {type(error).__name__}: {error}", True
        rows.append({"scenario": name, "seconds": time.monotonic() - begin, "outcome": outcome})
        print(f"{name}: {outcome}", flush=True)
    finish("Faults around a node", rows, options.json)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
