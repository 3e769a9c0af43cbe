# SPDX-License-Identifier: Apache-2.0
"""Keeps a node busy for many frames with everything that changes, and looks at what is left behind.

The node is a separate process. Meshes change on four topics, lights move by topics and parameters, resolutions and
depth formats switch, parameters are set, pipelines are exchanged, queries are asked; packed images come damaged and
must be refused; every few frames a second pipeline traces the same frame; a viewer of markers comes and goes. Each
frame must be answered before the next is sent. Every few hundred all meshes are cleared and a known one is traced: its
mask must have the library's bits. In the end memory is flat and no two pipelines disagreed.
"""

from __future__ import annotations

import argparse
import array
import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from compressed_images import damaged
from diagnostic_msgs.srv import SelfTest
from geometry_msgs.msg import PoseStamped
from harness import FOCAL, NodeProcess, Rig, info_msg, plate, reliable, wall
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from benchmark.faults import PATIENCE, check_end, expected, first_mask
from benchmark.fuzz_messages import add_normals, cloud_msg, pose_msg
from benchmark.fuzz_node import robust_slope
from shadow_tracer.ros.diagnostics import DEPTH, DEVICE, MESH, PROCESSING
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.wire.cdr_markers import (
    ADD,
    DELETE,
    DELETEALL,
    MarkerMessage,
    encode_marker,
    encode_markers,
    parse_markers,
)

SLOPE_LIMIT = 1024.0  # bytes per frame
WARM_UP = 0.2  # share of the frames
ENOUGH = 10_000  # frames; in fewer, kernels of all pipelines are not loaded soon enough to judge memory
SIZES = ((64, 48), (128, 96), (96, 72), (33, 41), (16, 12))
PIPELINES = ("light_grid", "mesh_bvh", "cone_hierarchy")
KINDS: dict[str, dict[str, Any]] = {
    "spot": {"lights.spot.type": "spot", "lights.spot.outer_angle": 0.5, "lights.spot.position": [0.2, -0.4, 0.0]},
    "sky": {"lights.sky.type": "directional", "lights.sky.direction": [0.1, 0.3, 1.0]},
    "ball": {"lights.ball.type": "sphere", "lights.ball.radius": 0.05, "lights.ball.position": [-0.3, -0.3, 0.0]},
}
LIGHT_SETS = (["lamp"], ["lamp", "spot"], ["lamp", "spot", "sky"], ["sky"], ["ball", "lamp"])
# What a checkpoint sets back; the lights are those of a node without parameters.
KNOWN: dict[str, Any] = {
    "light_names": ["lamp"],
    "lights.lamp.position": [0.5, -0.5, 0.0],
    "lights.lamp.range": 0.0,
    "lights.lamp.enabled": True,
    "bias.constant": 0.02,
    "bias.quadratic": 0.003,
    "bias.normal": 0.6,
    "depth_image_transport": "raw",
    "occluders": "mesh",
    "front_face_culling": False,
    "mask.unknown_value": 77,
    "distortion": "ignore",
}
# What camera_info says of the lens: nothing, something, and something that is refused.
LENSES = (
    ("plumb_bob", [0.0] * 5),
    ("plumb_bob", [-0.2, 0.05, 0.01, -0.002, 0.003]),
    ("equidistant", [0.3, 0.1, -0.05, 0.02]),
    ("plumb_bob", [-3.0, 0.0, 0.0, 0.0]),
    ("fisheye", [0.1] * 4),
)


class Soak:
    """The friend of a node that never leaves it alone."""

    def __init__(self, rig: Rig, process: NodeProcess, seed: int) -> None:
        self.rig = rig
        self.process = process
        self.rng = random.Random(seed)
        self.noise = np.random.default_rng(seed)
        friend = rig.friend
        self.marker = friend.create_publisher(Marker, "mesh_marker", reliable())
        self.markers = friend.create_publisher(MarkerArray, "mesh_markers", reliable())
        self.cloud = friend.create_publisher(PointCloud2, "mesh_cloud", reliable())
        self.raw = rig.depth
        self.packed = friend.create_publisher(CompressedImage, "depth/image_rect/compressedDepth", reliable())
        self.lamp = friend.create_publisher(PoseStamped, "shadow_tracer/lights/lamp/pose", reliable())
        self.query = friend.create_publisher(PointCloud2, "query", reliable())
        self.setter = rig.client(SetParametersAtomically, "shadow_tracer/set_parameters_atomically")
        self.clearing = rig.client(Trigger, "shadow_tracer/clear_meshes")
        self.testing = rig.client(SelfTest, "shadow_tracer/self_test")
        self.answers: list[PointCloud2] = []
        rig.listen(PointCloud2, "shadow_tracer/query/visibility", self.answers)
        self.triangles = np.zeros((0, 3), int)
        self.size = SIZES[0]
        self.encoding = "float32"
        self.pipeline = PIPELINES[0]
        self.lights = ["lamp"]
        self.asked = self.frames = self.checkpoints = self.seen = self.refusals = 0
        self.damaged = list(damaged(np.full((48, 64), 2000, np.uint16)))
        self.viewer: list[Subscription] = []
        self.memory: list[tuple[int, int]] = []
        self.reserved: dict[str, set[str]] = {}
        for publisher in (self.marker, self.markers, self.cloud, self.lamp, self.query):
            rig.until(publisher.get_subscription_count, what=f"{publisher.topic_name} is heard")

    # What changes

    def patches(self, count: int) -> np.ndarray:
        """Corners of small triangles between camera and wall, (3 * count, 3)."""
        middle = self.noise.uniform((-0.5, -0.4, 0.7), (0.5, 0.4, 1.5), (count, 3))
        return (middle[:, None] + self.noise.uniform(-0.1, 0.1, (count, 3, 3))).reshape(-1, 3)

    def change_mesh(self) -> None:
        """Deform the mesh, or send one with other triangles."""
        if self.rng.random() < 0.15 or not len(self.triangles):
            self.triangles = np.arange(3 * self.rng.choice((0, 1, 7, 100, 400))).reshape(-1, 3)
        self.rig.mesh.publish(encode_mesh(self.patches(len(self.triangles)), self.triangles, self.rng.random() < 0.8))

    def any_marker(self) -> MarkerMessage:
        """Add, modify, move or delete one of a few."""
        number = self.rng.randrange(6)
        action = self.rng.choice((ADD, ADD, ADD, ADD, DELETE, DELETEALL if number == 0 else ADD))
        points = self.patches(self.rng.choice((1, 20, 50))) if self.rng.random() < 0.5 else plate(half=0.05)[0][:3]
        angle = self.rng.uniform(-0.2, 0.2)
        return MarkerMessage(
            ns=self.rng.choice(("arm", "base")), id=number, action=action, frame="camera", points=points,
            position=(self.rng.uniform(-0.3, 0.3), 0.0, 0.0), orientation=(0.0, 0.0, np.sin(angle), np.cos(angle)),
            scale=(self.rng.uniform(0.5, 1.5), 1.0, 1.0), lifetime=self.rng.choice((0, 200_000_000)),
            frame_locked=self.rng.random() < 0.5,
        )  # fmt: skip

    def change_things(self) -> None:
        """Some of everything."""
        rng = self.rng
        if rng.random() < 0.6:
            self.change_mesh()
        if rng.random() < 0.3:
            self.marker.publish(encode_marker(self.any_marker()))
        if rng.random() < 0.1:
            self.markers.publish(encode_markers([self.any_marker() for _ in range(rng.randrange(5))]))
        if rng.random() < 0.1:
            self.cloud.publish(cloud_msg(self.patches(rng.choice((0, 1, 30))), self.rig.stamp))
        if rng.random() < 0.3:
            place = (rng.uniform(-1, 1), rng.uniform(-1, 0), rng.uniform(-0.2, 0.2))
            self.lamp.publish(pose_msg(self.rig.stamp, "camera", place))
        if rng.random() < 0.05:
            self.asked += 1
            points = cloud_msg(self.patches(rng.choice((0, 1, 100))), self.rig.stamp)
            self.query.publish(add_normals(points) if rng.random() < 0.5 else points)
        if rng.random() < 0.05:
            self.set(**self.any_parameters())
        if rng.random() < 0.02:
            self.watch()
        if rng.random() < 0.03:
            self.size, self.encoding = rng.choice(SIZES), rng.choice(("float32", "uint16"))

    def watch(self) -> None:
        """Somebody begins to look at what casts and what shines, or ceases to."""
        friend = self.rig.friend
        if self.viewer:
            for subscription in self.viewer:
                friend.destroy_subscription(subscription)
            self.viewer = []
            return
        profile = reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
        for topic in ("shadow_tracer/scene_markers", "shadow_tracer/light_markers"):
            self.viewer.append(friend.create_subscription(MarkerArray, topic, self.look, profile, raw=True))

    def look(self, data: bytes) -> None:
        """Every array stands for all there is."""
        assert parse_markers(data, 1_000_000)[0].action == DELETEALL
        self.seen += 1

    def any_parameters(self) -> dict[str, Any]:
        """A few parameters and good values for them."""
        rng = self.rng
        choices: dict[str, Any] = {
            "bias.quadratic": rng.uniform(0.0, 0.01),
            "bias.normal": rng.choice((0.0, 0.6, 2.0)),
            "lights.lamp.position": [rng.uniform(-1, 1), rng.uniform(-1, 0), 0.0],
            "lights.lamp.range": rng.choice((0.0, 2.2, 1e6)),
            "lights.lamp.enabled": rng.random() < 0.8,
            "light_names": rng.choice(LIGHT_SETS),
            "occluders": rng.choice(("mesh", "depth", "mesh+depth")),
            "front_face_culling": rng.random() < 0.3,
            "mask.unknown_value": rng.choice((0, 77, 128)),
            "mask.publish": rng.choice(("listened", "always")),
            "markers.max_triangles": rng.choice((0, 60, 100_000)),
            "process": rng.choice(("latest", "every")),
            "mesh.max_age": rng.choice((0.0, 60.0)),
            "depth_image_transport": rng.choice(("raw", "compressedDepth")),
            "depth.unit": rng.choice((0.001, 0.0011)),
            "camera_info_policy": rng.choice(("auto", "exact", "latest")),
            "distortion": rng.choice(("auto", "apply", "ignore")),
        }
        chosen = {name: choices[name] for name in rng.sample(sorted(choices), rng.randrange(1, 4))}
        if "light_names" in chosen:
            self.lights = chosen["light_names"]
            chosen |= {key: value for name in self.lights for key, value in KINDS.get(name, {}).items()}
        chosen["bias.constant"] = rng.uniform(0.0, 0.05)
        return {key: value for key, value in chosen.items() if "lamp" in self.lights or ".lamp." not in key}

    def set(self, **values: Any) -> None:
        """Set parameters; they must be taken. A light's own exist once it is in the list, so the list goes first."""
        for part in ([{"light_names": values["light_names"]}] if "light_names" in values else []) + [values]:
            changes = [Parameter(name, value=value).to_parameter_msg() for name, value in part.items()]
            answer = self.setter.call_async(SetParametersAtomically.Request(parameters=changes))
            self.rig.until(answer.done, what=f"an answer to {part}")
            result = answer.result().result
            assert result.successful, f"frame {self.frames}: {part} refused: {result.reason}"
        if "depth_image_transport" in values:
            raw = values["depth_image_transport"] == "raw"
            self.rig.depth, self.rig.codec = (self.raw, "") if raw else (self.packed, self.rng.choice(("png", "rvl")))
        if "process" in values or "depth_image_transport" in values:
            first_mask(self.rig)  # another topic or depth of the queue is another subscription, which has to be found

    # Frames

    def frame(self) -> np.ndarray:
        """Send a frame; its mask must come."""
        width, height = self.size
        depth = wall(width, height, self.rng.uniform(1.8, 2.2))
        depth[:: self.rng.randrange(2, 9), :: self.rng.randrange(2, 9)] += np.float32(self.rng.uniform(-0.2, 0.2))
        if self.encoding == "uint16":
            depth = np.nan_to_num(depth * 1000).astype(np.uint16)
        if self.rig.codec and self.rng.random() < 0.02:
            self.send_damaged(depth)
        return self.trace(depth)

    def send_damaged(self, depth: np.ndarray) -> None:
        """Send a packed depth image that cannot be read; it must be refused."""
        what, format, data, _ = self.rng.choice(self.damaged)
        msg = self.rig.depth_msg(depth, self.rig.next_stamp())
        msg.format, msg.data = format, array.array("B", data)
        self.rig.depth.publish(msg)
        self.refusals += 1
        refusals = str(self.refusals)
        self.rig.until(lambda: self.rig.value(DEPTH, "refused") == refusals, what=f"{what} is refused")

    def trace(self, depth: np.ndarray) -> np.ndarray:
        """Send a depth image; its mask must come."""
        stamp = self.rig.next_stamp()
        height, width = depth.shape
        info = info_msg(width, height, stamp, FOCAL * width / 64)
        info.distortion_model, info.d = self.rng.choice(LENSES)
        self.rig.info.publish(info)
        self.rig.depth.publish(self.rig.depth_msg(depth, stamp))
        mask = self.rig.mask_of(stamp, timeout=60.0)
        self.frames += 1
        for heard in (*self.rig.masks.values(), self.rig.timings, self.rig.infos):
            heard.clear()
        del self.rig.reports[:-1]
        return mask

    def exchange_pipeline(self) -> None:
        """The next pipeline; frames wait until it is loaded."""
        self.pipeline = PIPELINES[(PIPELINES.index(self.pipeline) + 1) % len(PIPELINES)]
        self.set(pipeline=self.pipeline, variant="")

    def self_test(self) -> None:
        """Every pipeline on the built-in scene, while the node goes on."""
        answer = self.testing.call_async(SelfTest.Request())
        while not answer.done():
            self.frame()
        assert answer.result().passed, str(answer.result().status)

    def checkpoint(self) -> None:
        """All meshes away, parameters as they were, and one mesh: the library's mask."""
        answer = self.clearing.call_async(Trigger.Request())
        self.rig.until(answer.done, what="~/clear_meshes answers")
        self.set(**KNOWN)
        self.lights = ["lamp"]
        self.lamp.publish(pose_msg(0, "", (0.5, -0.5, 0.0)))
        vertices, self.triangles = plate(x=self.rng.uniform(-0.1, 0.1))
        self.rig.mesh.publish(encode_mesh(vertices, self.triangles))
        mask = expected(vertices, self.triangles)
        deadline = time.monotonic() + PATIENCE
        while not np.array_equal(traced := self.trace(wall()), mask):
            if time.monotonic() > deadline:
                differing = f"{int((traced != mask).sum())} pixels differ from the library's mask"
                raise AssertionError(f"frame {self.frames}, after ~/clear_meshes: {differing}; {self.state()}")
        self.checkpoints += 1

    def state(self) -> str:
        """What the node says about itself."""
        self.rig.reports.clear()
        self.rig.until(lambda: self.rig.reports, what="/diagnostics")
        pairs = [f"{pair.key}: {pair.value}" for status in self.rig.reports[-1].status for pair in status.values]
        return f"{self.rig.last_statuses()}; {', '.join(pairs)}"

    def measure(self) -> None:
        """Memory of the node, resident and reserved on the device."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        self.memory.append((self.frames, pages * os.sysconf("SC_PAGE_SIZE")))
        if self.rig.value(DEVICE, "pipeline") == self.pipeline:
            self.reserved.setdefault(self.pipeline, set()).add(self.rig.value(DEVICE, "reserved [MB]"))


def run(frames: int, seed: int, exchange_every: int, self_test_every: int) -> tuple[list[dict[str, Any]], list[str]]:
    """Soak a node; the figures, and what was wrong."""
    # What is sent best effort between processes may be lost, and a frame that was lost says nothing about the node.
    heard = {
        f"qos_overrides./depth/{topic}.subscription.reliability": "reliable" for topic in ("image_rect", "camera_info")
    }
    with Rig(start=False) as rig, NodeProcess({"mask.unknown_value": 77, "verify_every": 7, **heard}) as process:
        process.wait_for("Ready")
        rig.connected()
        first_mask(rig)
        soak = Soak(rig, process, seed)
        begin = time.monotonic()
        while soak.frames < frames:
            if soak.frames % exchange_every == exchange_every - 1:
                soak.exchange_pipeline()
            soak.change_things()
            soak.frame()
            if soak.frames % self_test_every < 1:
                soak.self_test()
            if soak.frames % 500 < 2:
                soak.checkpoint()
            if soak.frames % 20 == 0:
                soak.measure()
        seconds = time.monotonic() - begin
        rig.reports.clear()
        rig.until(lambda: rig.value(PROCESSING, "verified frames"), what="/diagnostics")
        figures = {key: rig.value(PROCESSING, key) for key in ("verified frames", "differing", "faults", "dropped")}
        figures |= {"meshes refused": rig.value(MESH, "refused"), "last fault": rig.value(PROCESSING, "last fault")}
        check_end(process, signal.SIGTERM)
    return _judge(soak, figures, seconds)


def _judge(soak: Soak, figures: dict[str, str], seconds: float) -> tuple[list[dict[str, Any]], list[str]]:
    numbers, sizes = zip(*[entry for entry in soak.memory if entry[0] >= WARM_UP * soak.frames], strict=True)
    slope = robust_slope(numbers, sizes)
    reserved = {name: sorted(values) for name, values in soak.reserved.items()}
    wrong = [
        f"{key}: {value}" for key, value in figures.items() if key != "verified frames" and value not in ("0", "-")
    ]
    if figures["verified frames"] == "0":
        wrong.append("no frame was verified")
    if not soak.seen:
        wrong.append("no markers were seen")
    if slope > SLOPE_LIMIT and soak.frames >= ENOUGH:
        wrong.append(f"resident memory grows by {slope:.0f} bytes per frame")
    wrong += [f"reserved on the device by {name}: {values} MB" for name, values in reserved.items() if len(values) > 1]
    lines: dict[str, Any] = {
        "frames, all answered": soak.frames,
        "milliseconds per frame, everything included": 1e3 * seconds / soak.frames,
        "checkpoints with the library's mask": soak.checkpoints,
        "arrays of markers seen": soak.seen,
        "queries asked": soak.asked,
        "queries answered": len(soak.answers),
        "damaged images, all refused": soak.refusals,
        **figures,
        f"resident memory after {WARM_UP:.0%} of the frames [MiB]": sizes[0] / 2**20,
        "resident memory at the end [MiB]": sizes[-1] / 2**20,
        "slope of resident memory [B/frame]": slope,
        "reserved on the device [MB]": "; ".join(f"{name} {'/'.join(values)}" for name, values in reserved.items()),
    }
    return [{"what": key, "value": value} for key, value in lines.items()], wrong


def main() -> int:
    """Soak, print a table, and say by the exit code whether all was right."""
    from benchmark.report import finish

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--exchange", type=int, default=1000, help="frames between two pipelines")
    parser.add_argument("--self-test", type=int, default=2000, help="frames between two self tests")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    rows, wrong = run(options.frames, options.seed, options.exchange, options.self_test)
    finish("A node that is never left alone", rows, options.json)
    for text in wrong:
        print(f"WRONG {text}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
