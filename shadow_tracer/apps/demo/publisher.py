# SPDX-License-Identifier: Apache-2.0
"""Plays a demo sequence over ROS topics: depth, camera_info, camera pose, mesh and colours.

A separate process: `python -m shadow_tracer.apps.demo.publisher`. The next frame goes out when the node's mask of the
last one has come back, so the node is never flooded and every frame is answered. Progress is printed as one JSON object
per line.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from queue import Full, Queue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.apps.demo.pace import Pace
from shadow_tracer.apps.demo.sequence import STILL_PIXELS, Sequence, View, open_sequence
from shadow_tracer.ros.wire.messages import rigid
from shadow_tracer.scene.camera import Camera

DEPTH_TOPIC = "depth/image_rect"
INFO_TOPIC = "depth/camera_info"
MESH_TOPIC = "mesh"
POSE_TOPIC = "camera_pose"
COLOUR_TOPIC = "color/image_rect"
MASK_TOPIC = "/shadow_tracer/mask"
CAMERA_FRAME = "camera_optical_frame"
WORLD_FRAME = "map"
LOOKAHEAD = 48
_SPEAKING = threading.Lock()
BUDGET, LONGEST_BUDGET = 28.0, 86400.0  # s
KEPT = 8  # messages a slow listener may lag behind


@dataclass(frozen=True)
class Parcel:
    """A view ready to be sent; the mesh already as bytes, None if unchanged."""

    index: int
    view: View
    mesh: bytes | None


class Renderer:
    """Makes the views of a sequence ahead of time, in a thread."""

    def __init__(self, sequence: Sequence) -> None:
        self._sequence = sequence
        self._queue: Queue[Parcel | Exception] = Queue(LOOKAHEAD)
        self._due = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="renderer", daemon=True)
        self._thread.start()

    def get(self, index: int) -> Parcel:
        """The view `index`, not before the one got last; waits for it. Raises what its making raised."""
        self._due = index  # views before it need not be made any more
        while True:
            parcel = self._queue.get()
            if isinstance(parcel, Exception):
                raise parcel
            if parcel.index == index:
                return parcel

    def stop(self) -> None:
        """Ends the thread."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        from shadow_tracer.ros.wire.cdr import encode_mesh

        for index in range(len(self._sequence)):
            if index < self._due:
                continue
            try:
                view = self._sequence.view(index)
                mesh = None if view.vertices is None else encode_mesh(view.vertices, self._sequence.triangles)
                parcel: Parcel | Exception = Parcel(index, view, mesh)
            except Exception as error:  # handed to the one who asks for the view
                parcel = error
            while not self._stop.is_set():
                try:
                    self._queue.put(parcel, timeout=0.1)
                    break
                except Full:
                    continue
            if self._stop.is_set() or isinstance(parcel, Exception):
                return
            say(rendered=index + 1)


class Player:
    """The ROS side: sends parcels and waits for their masks.

    Args:
        node: an rclpy node.
    """

    def __init__(self, node: Any) -> None:
        from geometry_msgs.msg import PoseStamped
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import CameraInfo, Image
        from shape_msgs.msg import Mesh

        self._node = node
        qos = QoSProfile(depth=KEPT, reliability=ReliabilityPolicy.RELIABLE)
        self._depth = node.create_publisher(Image, DEPTH_TOPIC, qos)
        self._info = node.create_publisher(CameraInfo, INFO_TOPIC, qos)
        self._mesh = node.create_publisher(Mesh, MESH_TOPIC, qos)
        self._pose = node.create_publisher(PoseStamped, POSE_TOPIC, qos)
        self._colour = node.create_publisher(Image, COLOUR_TOPIC, qos)
        self._answered = 0
        self._mask = node.create_subscription(Image, MASK_TOPIC, self._on_mask, qos)

    def _on_mask(self, mask: Any) -> None:
        self._answered = max(self._answered, stamp_ns(mask.header.stamp))

    def wait_for_listeners(self, timeout: float) -> bool:
        """Waits until node and collector listen to everything and the node offers its mask; False after `timeout` s."""
        wanted = ((self._depth, 2), (self._info, 2), (self._mesh, 1), (self._pose, 2), (self._colour, 1))
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if all(p.get_subscription_count() >= n for p, n in wanted) and self._node.count_publishers(MASK_TOPIC):
                return True
            self._spin(0.05)
        return False

    def send(self, parcel: Parcel) -> int:
        """Publishes a frame, what the depth image needs before the image itself; returns its stamp in nanoseconds."""
        from rclpy.duration import Duration

        view = parcel.view
        now = self._node.get_clock().now()
        stamp = now.to_msg()
        if parcel.mesh is not None:
            self._mesh.publish(parcel.mesh)
        self._pose.publish(pose_message(view.camera, stamp))
        self._info.publish(info_message(view.camera, stamp))
        self._colour.publish(image_message(view.colour, "rgb8", stamp))
        if parcel.mesh is not None:
            # topics have no order among them, and a mesh has no stamp: it must be there before the image it goes with
            self._mesh.wait_for_all_acked(Duration(seconds=2))
        self._depth.publish(image_message(view.depth, "32FC1" if view.depth.dtype == np.float32 else "16UC1", stamp))
        return int(now.nanoseconds)

    def wait_for_mask(self, stamp: int, timeout: float) -> bool:
        """Waits for the mask of the frame with this stamp; False after `timeout` seconds."""
        end = time.monotonic() + timeout
        while self._answered < stamp and time.monotonic() < end:
            self._spin(0.02)
        return self._answered >= stamp

    def _spin(self, timeout: float) -> None:
        import rclpy

        rclpy.spin_once(self._node, timeout_sec=timeout)


def say(**values: Any) -> None:
    """Prints one line of progress, whole even if several threads speak."""
    with _SPEAKING:
        print(json.dumps(values), flush=True)


def stamp_ns(stamp: Any) -> int:
    """A builtin_interfaces Time in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def image_message(pixels: NDArray[Any], encoding: str, stamp: Any) -> Any:
    """sensor_msgs/Image of a C-contiguous array."""
    from sensor_msgs.msg import Image

    message = Image(encoding=encoding, height=pixels.shape[0], width=pixels.shape[1], step=pixels.strides[0])
    message.header.stamp, message.header.frame_id = stamp, CAMERA_FRAME
    message.is_bigendian = int(sys.byteorder == "big")
    message.data.frombytes(memoryview(pixels).cast("B"))
    return message


def info_message(camera: Camera, stamp: Any) -> Any:
    """sensor_msgs/CameraInfo of a rectified camera."""
    from sensor_msgs.msg import CameraInfo

    c = camera
    message = CameraInfo(width=c.width, height=c.height, distortion_model="plumb_bob", d=[0.0] * 5)
    message.header.stamp, message.header.frame_id = stamp, CAMERA_FRAME
    message.k = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]
    message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    message.p = [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


def pose_message(camera: Camera, stamp: Any) -> Any:
    """geometry_msgs/PoseStamped of the optical frame."""
    from geometry_msgs.msg import PoseStamped

    message = PoseStamped()
    message.header.stamp, message.header.frame_id = stamp, WORLD_FRAME
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = (float(v) for v in camera.position)
    q.x, q.y, q.z, q.w = quaternion(camera.camera_to_world[:3, :3])
    return message


def quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w) of a (3, 3) rotation matrix."""
    r = rotation
    # the eigenvector of the largest eigenvalue: well conditioned for every angle
    k = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
        [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
        [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
    ])  # fmt: skip
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return float(x), float(y), float(z), float(w)


def as_sent(camera: Camera) -> Camera:
    """The camera as the node finds it in the messages: its rotation has gone through a quaternion, which rounds."""
    c = camera
    pose = rigid(c.position, quaternion(c.camera_to_world[:3, :3]), "camera_pose")
    return Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, pose)


def play(sequence: Sequence, budget: float, start_timeout: float, frame_timeout: float) -> int:
    """Plays the sequence; returns 0, or 1 if the node never listened or never answered."""
    import rclpy

    node = rclpy.create_node("demo_publisher")
    renderer = Renderer(sequence)
    try:
        player = Player(node)
        if not player.wait_for_listeners(start_timeout):
            say(error=f"nobody listened within {start_timeout:.0f} s")
            return 1
        say(listening=True)
        pace, index = Pace(sequence.animated, budget), 0
        while index < len(sequence):
            start = player.send(renderer.get(index))
            say(sent=index, stamp=start)
            # the first answer may have to wait for kernels to compile
            if player.wait_for_mask(start, frame_timeout if index else start_timeout):
                pace.answered(time.monotonic())
            elif index == 0:
                say(error=f"no mask within {start_timeout:.0f} s")
                return 1
            else:
                say(lost=index)
            due = pace.after(index)
            if due > index + 1:
                say(skipped=due - index - 1)
            index = due
        return 0
    finally:
        renderer.stop()
        node.destroy_node()


def options(parser: argparse.ArgumentParser) -> None:
    """Adds what demo and publisher share."""
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="play this folder of depth frames")
    parser.add_argument("--mesh", type=Path, metavar="FILE", help="mesh of the place in --data (default: looked for)")
    parser.add_argument("--frames", type=int, metavar="N", help="number of frames")
    parser.add_argument("--size", type=size, metavar="WxH", help="image size of the workshop's camera")
    text = "leave out frames if playing would take longer; 0 leaves out none (default: 28)"
    parser.add_argument("--budget", type=budget, default=BUDGET, metavar="S", help=text)


def size(text: str) -> tuple[int, int]:
    """(width, height) of a text such as 640x480."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"size: must be WIDTHxHEIGHT such as 640x480, got {text!r}") from None
    if not (16 <= width and 16 <= height and width * height <= STILL_PIXELS):
        raise argparse.ArgumentTypeError(f"size: must be 16x16 to {STILL_PIXELS} pixels in all, got {text!r}")
    return width, height


def budget(text: str) -> float:
    """Seconds of a text such as 28; 0 is no limit."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds <= LONGEST_BUDGET:  # NaN is not either
        raise argparse.ArgumentTypeError(f"budget: expected 0 to {LONGEST_BUDGET:g} seconds, got {text!r}")
    return seconds


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="python -m shadow_tracer.apps.demo.publisher", description="Plays a sequence."
    )
    options(parser)
    parser.add_argument("--start-timeout", type=float, default=300.0, metavar="S", help="wait this long for the node")
    parser.add_argument("--frame-timeout", type=float, default=20.0, metavar="S", help="wait this long for a mask")
    chosen = parser.parse_args(arguments)
    import rclpy
    from rclpy.executors import ExternalShutdownException

    try:
        sequence = open_sequence(chosen.data, chosen.mesh, chosen.frames, chosen.size or (640, 480))
        rclpy.init()
        return play(sequence, chosen.budget, chosen.start_timeout, chosen.frame_timeout)
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except (ValueError, RuntimeError) as error:
        say(error=str(error))
        return 1
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
