# SPDX-License-Identifier: Apache-2.0
"""Each parameter file in config/ starts a node that does what the file promises. Expected masks are computed here, from
rectangles and lights, in float64."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tf_double
import yaml
from camera_rig import CameraRig
from harness import FOCAL, HEIGHT, WIDTH, Rig, nanoseconds, wall
from sensor_msgs.msg import Image
from std_msgs.msg import Float32
from visualization_msgs.msg import MarkerArray

from shadow_tracer.ros.parameters import parameters
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_markers
from shadow_tracer.scene.sun import parse_time

CONFIG = Path(__file__).resolve().parents[3] / "config"
USES = (
    *("rover_sun", "uv_lamp", "onboard_spotlight", "second_sensor_line_of_sight", "indoor_lights"),
    *("robot_self_shadow", "several_cameras"),
)
SECOND = 1_000_000_000
DOWN = (1.0, 0.0, 0.0, 0.0)  # x y z w of an optical frame that looks down, its x along x
MARGIN = 0.03  # what is this close to an edge, in parts of the size, is not compared

Rectangle = tuple[Sequence[float], Sequence[float], Sequence[float]]  # middle, two half edges


def flat(x: float, y: float, z: float, half: float) -> Rectangle:
    """A level square."""
    return (x, y, z), (half, 0.0, 0.0), (0.0, half, 0.0)


def mesh_of(rectangles: Sequence[Rectangle]) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) vertices and (T, 3) triangles of rectangles."""
    vertices, triangles = [], []
    for middle, u, v in np.asarray(rectangles, float):
        first = len(vertices)
        vertices += [middle - u - v, middle + u - v, middle + u + v, middle - u + v]
        triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return np.array(vertices), np.array(triangles)


@dataclass(frozen=True)
class Lamp:
    """A light as a test expects it, in the world. Without a position it is parallel light."""

    position: tuple[float, float, float] | None = None
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    angle: float = math.pi
    range: float = math.inf

    def reaches(self, points: np.ndarray, rectangles: Sequence[Rectangle], bias: float, scale: float) -> np.ndarray:
        """Which (N, 3) points it reaches, if rectangles were larger, and cone, range and bias smaller, by ``scale``."""
        if self.position is None:
            way = np.broadcast_to(-1e3 * np.asarray(self.direction), points.shape)
        else:
            way = np.asarray(self.position) - points
        length = np.linalg.norm(way, axis=1)
        axis = np.asarray(self.direction) / np.linalg.norm(self.direction)
        lit = (way @ -axis / length >= math.cos(min(self.angle / scale, math.pi))) & (length <= self.range / scale)
        if self.position is None:
            lit[:] = True
        for middle, u, v in np.asarray(rectangles, float):
            normal = np.cross(u, v)
            with np.errstate(divide="ignore", invalid="ignore"):  # a ray along the plane meets nothing
                t = ((middle - points) @ normal) / (way @ normal)
                place = points + t[:, None] * way - middle
                a, b = place @ u / (u @ u), place @ v / (v @ v)
            lit &= ~((t * length > bias / scale) & (t < 1.0) & (abs(a) <= scale) & (abs(b) <= scale))
        return lit


def check(
    mask: np.ndarray,
    points: np.ndarray,
    lamps: Sequence[Lamp],
    rectangles: Sequence[Rectangle] = (),
    bias: float = 0.0,
) -> None:
    """The mask (H, W) is 255 where one of the lamps reaches the points (H * W, 3), else 0; edges are not compared."""
    bright, dark = (
        np.any([lamp.reaches(points, rectangles, bias, scale) for lamp in lamps], axis=0)
        for scale in (1.0 - MARGIN, 1.0 + MARGIN)
    )
    sure = (bright == dark) & (np.arange(mask.size) > 0)  # the first pixel has no depth
    assert sure.mean() > 0.8 and bright[sure].any() and not bright[sure].all(), "the test says nothing"
    wrong = ((mask.ravel() == 255) != bright) & sure
    assert not wrong.any(), (
        f"{wrong.sum()} of {sure.sum()} pixels, the first at {np.argwhere(wrong.reshape(mask.shape))[0]}"
    )
    assert set(np.unique(mask.ravel()[1:])) <= {0, 255}


def pixels(depth: np.ndarray) -> np.ndarray:
    """(H * W, 3) points of a depth image in its optical frame."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    z = depth.astype(np.float64)
    points = np.stack(
        [(u - (depth.shape[1] - 1) / 2) / FOCAL * z, (v - (depth.shape[0] - 1) / 2) / FOCAL * z, z], axis=2
    )
    return points.reshape(-1, 3)


def floor(height: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """(H * W, 3) points of a floor at z = 0 that a camera sees which looks down from a height above (x, y)."""
    depth = np.full((HEIGHT, WIDTH), height)
    return pixels(depth) * (1.0, -1.0, -1.0) + (x, y, height)


class Bench:
    """A node with a parameter file of ours, and tf to be filled."""

    def __init__(self, rig: Rig, tf: list[tf_double.Buffer]) -> None:
        self.rig = rig
        self._tf = tf
        self._bits: list[Image] = []

    def place(self, parent: str, child: str, *pose: Sequence[float]) -> None:
        """A static transform: translation [m] and quaternion x y z w."""
        self._tf[-1].set_transform_static(tf_double.transform(parent, child, 0, *pose), "test")

    def move(self, parent: str, child: str, stamp: int, *pose: Sequence[float]) -> None:
        """A transform at a stamp [ns]."""
        self._tf[-1].set_transform(tf_double.transform(parent, child, stamp, *pose), "test")

    def hear(self, *lights: str) -> None:
        """Listen to the masks of lights, and to the bits of all."""
        for light in lights:
            self.rig.listen_to_light(light)
        self.rig.listen(Image, "shadow_tracer/light_bits", self._bits)
        subscription = list(self.rig.friend.subscriptions)[-1]
        self.rig.until(subscription.get_publisher_count, what="light_bits is published")

    def bits_of(self, stamp: int) -> np.ndarray:
        """The bits that belong to a frame, (H, W) uint8."""

        def found() -> Image | None:
            return next((m for m in self._bits if m.header.stamp.sec * SECOND + m.header.stamp.nanosec == stamp), None)

        msg = self.rig.until(found, what="light_bits of the frame")
        assert (msg.encoding, msg.step) == ("mono8", msg.width)
        return np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.width)

    def floor(self, height: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
        """The points of :func:`floor`, moved up as far as the file's bias along the normal says."""
        assert self.rig.node is not None
        return floor(height, x, y) + (0.0, 0.0, self.rig.node.settings.bias.normal * self.bias_at(height))

    def check_lights(
        self, stamp: int, points: np.ndarray, lamps: dict[str, Lamp], rectangles: Sequence[Rectangle]
    ) -> None:
        """The mask of each lamp, the mask of all, and the bits of a frame."""
        bits, bias = self.bits_of(stamp), self.bias_at(4.0)
        for number, (name, lamp) in enumerate(lamps.items()):
            mask = self.rig.mask_of(stamp, name)
            check(mask, points, [lamp], rectangles, bias)
            assert ((bits >> number & 1 == 1) == (mask == 255)).ravel()[1:].all()
        assert bits.max() < 1 << len(lamps)

    def bias_at(self, depth: float) -> float:
        """Bias of the file at a depth [m]."""
        assert self.rig.node is not None
        bias = self.rig.node.settings.bias
        return bias.constant + bias.quadratic * depth**2


@pytest.fixture
def bench(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """A node started with the file that the test is marked with."""
    module, made = tf_double.module()
    monkeypatch.setitem(sys.modules, "tf2_ros", module)
    with Rig(arguments=["--params-file", str(CONFIG / f"{request.param}.yaml")]) as rig:
        yield Bench(rig, made)


def uses(name: str) -> Callable[[Any], Any]:
    """Mark a test as one of a node that was started with this file."""
    return pytest.mark.parametrize("bench", [name], indirect=True)


@pytest.mark.parametrize("name", USES)
def test_a_file_names_only_parameters_that_there_are(name: str) -> None:
    values = yaml.safe_load((CONFIG / f"{name}.yaml").read_text())["/**"]["ros__parameters"]
    assert parameters.problems_in(values) == []
    lights = list(values["light_names"])
    assert parameters.unknown_names(values, parameters.names_in(values), lights, values.get("camera_names", ())) == []
    changed = {key for key, value in values.items() if value != parameters.default_of(key)}
    assert {"light_names", "bias.constant", "camera_names"} & changed, "nothing differs from the defaults"


@pytest.mark.parametrize("name", USES)
def test_a_file_says_how_to_start_it_and_explains_every_value(name: str) -> None:
    lines = (CONFIG / f"{name}.yaml").read_text().splitlines()
    head = "\n".join(lines[: lines.index("/**:")])
    assert f"ros2 run shadow_tracer shadow_node --ros-args --params-file {name}.yaml" in head
    assert all(len(line) <= 122 for line in lines)


def test_every_use_is_tested() -> None:
    assert {path.stem for path in CONFIG.glob("*.yaml")} - {"default"} == set(USES)


# Several cameras


def test_several_cameras_look_at_one_world(monkeypatch: pytest.MonkeyPatch) -> None:
    """From two places, through tf; each mask is that of the lamp and the plate in the map."""
    module, tf = tf_double.module()
    monkeypatch.setitem(sys.modules, "tf2_ros", module)
    given = yaml.safe_load((CONFIG / "several_cameras.yaml").read_text())["/**"]["ros__parameters"]
    assert {name: given.pop(name) for name in ("bounds.max_rays", "bounds.max_lights")}["bounds.max_rays"] == 640 * 480
    plates = [flat(0.3, 0.0, 1.2, 0.25)]
    with CameraRig(given | {"pose_source": "tf"}) as rig:
        for name, x in (("front", 0.0), ("rear", 0.6)):
            tf[-1].set_transform_static(tf_double.transform("map", f"{name}_optical", 0, (x, 0.0, 4.0), DOWN), "test")
        rig.send_mesh(*mesh_of(plates))
        for name, x, constant in (("front", 0.0, 0.02), ("rear", 0.6, 0.05)):
            bias = constant + 0.003 * 4.0**2
            points = floor(4.0, x) + (0.0, 0.0, 0.6 * bias)
            mask = rig.look(name, wall(distance=4.0), frame=f"{name}_optical")
            check(mask, points, [Lamp((0.0, 0.0, 2.4))], plates, bias)
        assert rig.core.inputs.cameras["rear"].limit.rate == 15.0


# Sun

LATITUDE, TILT = math.radians(38.4064), math.radians(23.436)
# True noon at 110.7919 degrees west on the day of the solstice: 7 h 23 min 10 s after 12:00, and 1 min 50 s more,
# because the true sun is that much behind the mean one.
NOON = parse_time("2026-06-21T19:25:00Z")


def sunlight(hours: float) -> tuple[float, float, float]:
    """The way sunlight travels there at the solstice, hours after true noon: plain trigonometry of the celestial
    sphere, without refraction."""
    turn = math.radians(15.0 * hours)
    east = -math.cos(TILT) * math.sin(turn)
    north = math.cos(LATITUDE) * math.sin(TILT) - math.sin(LATITUDE) * math.cos(TILT) * math.cos(turn)
    up = math.sin(LATITUDE) * math.sin(TILT) + math.cos(LATITUDE) * math.cos(TILT) * math.cos(turn)
    return -east, -north, -up


@pytest.mark.parametrize("hours", [0, -3, 4], ids=["noon", "morning", "afternoon"])
@uses("rover_sun")
def test_rover_sun_shadows_fall_where_the_sun_throws_them(bench: Bench, hours: int) -> None:
    pytest.importorskip("ephem", reason="needs ephem: pip install 'shadow_tracer[sun]'")
    bench.place("map", "camera", (0.0, 0.0, 4.0), DOWN)
    plates = [flat(0.0, 0.0, 0.6, 0.5), flat(1.2, -0.7, 0.3, 0.2)]
    bench.rig.send_mesh(*mesh_of(plates))
    mask = bench.rig.trace(wall(distance=4.0), stamp=NOON + hours * 3600 * SECOND)
    check(mask, bench.floor(4.0), [Lamp(direction=sunlight(hours))], plates)
    assert mask[0, 0] == 128  # no depth


@uses("rover_sun")
def test_rover_sun_at_night_everything_is_in_shadow(bench: Bench) -> None:
    pytest.importorskip("ephem", reason="needs ephem: pip install 'shadow_tracer[sun]'")
    bench.place("map", "camera", (0.0, 0.0, 4.0), DOWN)
    assert sunlight(-10.0)[2] > 0.2
    mask = bench.rig.trace(wall(distance=4.0), stamp=NOON - 10 * 3600 * SECOND)
    assert mask[0, 0] == 128 and (mask.ravel()[1:] == 0).all()
    assert bench.rig.set(lights__sun__sun__time="2026-06-21T19:25:00Z") == ""  # a recording, played as of noon
    mask = bench.rig.trace(wall(distance=4.0), stamp=NOON - 10 * 3600 * SECOND + 1)
    assert (mask.ravel()[1:] == 255).all()


@uses("rover_sun")
def test_rover_sun_rocks_that_only_the_camera_sees_cast_shadow(bench: Bench) -> None:
    pytest.importorskip("ephem", reason="needs ephem: pip install 'shadow_tracer[sun]'")
    bench.place("map", "camera", (0.0, 0.0, 4.0), DOWN)
    depth = wall(distance=4.0)
    depth[18:30, 26:38] = 3.4  # a rock, 60 cm high and 70 cm wide
    mask = bench.rig.trace(depth, stamp=NOON - 4 * 3600 * SECOND)
    rock = pixels(depth)[np.ravel_multi_index((23, 31), depth.shape)] * (1.0, -1.0, -1.0) + (0.0, 0.0, 4.0)
    way = np.array(sunlight(-4.0))
    bias = bench.rig.node.settings.bias.normal * bench.bias_at(4.0)
    u, v = (rock - way * (rock[2] - bias) / way[2])[:2] * (1.0, -1.0) / 4.0 * FOCAL + (
        (WIDTH - 1) / 2,
        (HEIGHT - 1) / 2,
    )
    column, row = round(u), round(v)
    assert column < 26 and (mask[row - 1 : row + 2, column - 1 : column + 2] == 0).all()  # the sun is in the east
    assert (mask[:, 42:] == 255).all() and (mask[20:28, 28:36] == 255).all()


# UV lamp


def of_tube(points: np.ndarray, foot: tuple[float, float], rectangles: Sequence[Rectangle], bias: float) -> np.ndarray:
    """W/m2 on a level floor, summed over many pieces of a line of one metre, 12 W, upright on ``foot``."""
    total = np.zeros(len(points))
    for height in (np.arange(200) + 0.5) / 200:
        v = (*foot, height) - points
        distance = np.linalg.norm(v, axis=1)
        sine = np.linalg.norm(v[:, :2], axis=1) / distance
        reached = Lamp((*foot, height)).reaches(points, rectangles, bias, 1.0)
        total += reached * 12.0 / math.pi**2 / 200 * sine * v[:, 2] / distance**3
    return total


@uses("uv_lamp")
def test_uv_lamp_gives_what_a_tube_gives_in_shadow_and_out_of_it(bench: Bench) -> None:
    bench.place("map", "camera", (0.6, 0.0, 4.0), DOWN)
    heard = bench.rig.collect(Image, "shadow_tracer/irradiance")
    wall_of_30_cm = ((0.6, 0.0, 0.15), (0.0, 0.4, 0.0), (0.0, 0.0, 0.15))
    bench.rig.send_mesh(*mesh_of([wall_of_30_cm]))
    points = floor(4.0, 0.6)
    for foot in ((0.0, 0.0), (0.3, -0.2)):  # the robot moves, and with it the lamp
        bench.place("map", "uv_lamp", (*foot, 0.0), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
        bench.rig.node.core.frames.clear()  # static transforms are only looked up again after a while
        stamp = bench.rig.send_frame(wall(distance=4.0))
        msg = bench.rig.until(lambda: next((m for m in heard if nanoseconds(m.header.stamp) == stamp), None))  # noqa: B023
        found = np.frombuffer(msg.data, np.float32)
        away = np.linalg.norm(points[:, :2] - foot, axis=1)
        expected, whole = (of_tube(points, foot, hiding, bench.bias_at(4.0)) for hiding in ([wall_of_30_cm], []))
        sure = (away > 0.1) & (np.arange(len(points)) > 0)
        error = np.abs(found - expected)[sure] / whole[sure]
        # 64 points lie in steps of 1.6 cm, and the pixel beside an edge has another place on each side of it.
        assert np.quantile(error, 0.98) < 0.02 and (expected < 0.9 * whole)[sure].mean() > 0.05
        assert np.isnan(found[0])  # no depth


def test_uv_lamp_promises_nothing_that_is_not_computed() -> None:
    """Of reflections and of disinfection it says only that they are not computed; nor do the pages that name it."""
    text = (CONFIG / "uv_lamp.yaml").read_text()
    head, _, rest = text.partition("# What is NOT computed: ")
    denied, _, values = rest.partition("/**:")
    for word in ("reflected", "disinfected", "no proof"):
        assert word in denied, word
    for word in ("disinfect", "reflect", "germs"):
        assert word not in head + values, word
    for page in (CONFIG.parent / "README.md", CONFIG.parent / "docs" / "node.md"):
        lines = [line for line in page.read_text().splitlines() if "uv_lamp" in line]
        assert lines and not [line for line in lines if "disinfect" in line], page.name


@pytest.mark.slow  # an exposure is added once a second
@uses("uv_lamp")
def test_uv_lamp_sums_up_what_the_room_receives(bench: Bench) -> None:
    bench.place("map", "camera", (0.0, 0.0, 4.0), DOWN)
    bench.place("map", "uv_lamp", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    coverage = bench.rig.collect(Float32, "shadow_tracer/dose/coverage")
    bench.rig.send_mesh(*mesh_of([flat(0.0, 0.0, 0.0, 1.0)]))

    def exposed() -> bool:
        bench.rig.mask_of(bench.rig.send_frame(wall(distance=4.0)))
        return bool(coverage)

    bench.rig.until(exposed, timeout=20.0, what="an exposure")
    made = bench.rig.node.core.exposure.maps["mesh"]
    expected = made.seconds * of_tube(made.positions(), (0.0, 0.0), [], 0.0)
    assert made.seconds >= 1.0 and made.dose == pytest.approx(expected, rel=0.02)
    assert coverage[-1].data == pytest.approx(made.coverage(280.0))


# Spotlight on board

HEADLIGHT = Lamp((0.2, -0.05, 0.0), (-0.0667, 0.0167, 1.0), 0.436, 8.0)


def before_a_wall() -> tuple[np.ndarray, Rectangle]:
    """Depth of a box in front of a wall, and the side of the box that the camera sees."""
    depth = wall(distance=4.0)
    depth[16:33, 28:41] = 2.0
    corners = pixels(depth).reshape(HEIGHT, WIDTH, 3)[[16, 32], [28, 40]]
    (x, y, z), (half_x, half_y, _) = corners.mean(axis=0), (corners[1] - corners[0]) / 2
    return depth, ((x, y, z), (half_x, 0.0, 0.0), (0.0, half_y, 0.0))


def check_headlight(bench: Bench, mask: np.ndarray) -> None:
    """Dark outside the cone, and on the wall to the left of the box, which the light does not reach from the right."""
    depth, box = before_a_wall()
    check(mask, pixels(depth), [HEADLIGHT], [box], bench.bias_at(2.0))
    assert (mask[18:31, 26:28] == 0).all() and (mask[18:31, 28:50] == 255).all()


@uses("onboard_spotlight")
def test_onboard_spotlight_needs_nothing_but_depth(bench: Bench) -> None:
    depth, _ = before_a_wall()
    mask = bench.rig.trace(depth)
    check_headlight(bench, mask)
    assert mask[0, 0] == 128 and not bench.rig.node.core.frames.has_tf
    bench.rig.send_mesh(*mesh_of([flat(0.0, 0.0, 1.0, 5.0)]))  # would shadow everything
    assert (bench.rig.trace(depth) == mask).all()
    far = bench.rig.trace(wall(distance=8.5))  # out of range
    assert (far.ravel()[1:] == 0).all()


@uses("onboard_spotlight")
def test_onboard_spotlight_rides_on_the_camera(bench: Bench) -> None:
    """With a fixed frame, as the file says how: the same view has the same shadows wherever the camera is."""
    rig = bench.rig
    changes = {"fixed_frame": "odom", "lights.headlight.frame": "camera", "occluders": "mesh+depth"}
    assert rig.set(**{name.replace(".", "__"): value for name, value in changes.items()}) == ""
    depth, _ = before_a_wall()
    stamp = rig.next_stamp()
    for step in range(3):
        turn = 0.2 * step
        pose = (0.5 * step, -0.3, 1.0), (0.0, math.sin(turn), 0.0, math.cos(turn))
        bench.move("odom", "camera", stamp + step * SECOND, *pose)
        check_headlight(bench, rig.trace(depth, stamp=stamp + step * SECOND))


# Line of sight of a second sensor


@uses("second_sensor_line_of_sight")
def test_second_sensor_sees_what_nothing_hides_from_it(bench: Bench) -> None:
    rig = bench.rig
    bench.place("base_link", "camera", (0.5, 0.0, 3.0), DOWN)
    bench.place("base_link", "lidar_link", (0.0, 0.0, 1.2))
    bench.hear("lidar", "wrist_camera")
    plates = [flat(0.4, 0.1, 0.5, 0.15)]
    rig.send_mesh(*mesh_of(plates))
    stamp = rig.next_stamp()
    down = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))  # the wrist looks down: its x is -z
    for seconds, x in ((0, 0.2), (1, 1.0)):
        bench.move("base_link", "wrist_camera_link", stamp + seconds * SECOND, (x, 0.0, 1.0), down)
    stamp = rig.send_frame(wall(distance=3.0), stamp=stamp + SECOND // 2)
    lamps = {"lidar": Lamp((0.0, 0.0, 1.2), range=30.0), "wrist_camera": Lamp((0.6, 0.0, 1.0), angle=0.6, range=3.0)}
    bench.check_lights(stamp, bench.floor(3.0, 0.5), lamps, plates)
    assert rig.mask_of(stamp)[0, 0] == 128
    assert rig.set(lights__wrist_camera__enabled=False) == ""
    stamp = rig.send_frame(wall(distance=3.0), stamp=stamp + 1)
    check(rig.mask_of(stamp), bench.floor(3.0, 0.5), [lamps["lidar"]], plates)


@uses("second_sensor_line_of_sight")
def test_second_sensor_whose_place_is_not_known(bench: Bench) -> None:
    bench.place("base_link", "camera", (0.5, 0.0, 3.0), DOWN)
    bench.place("base_link", "wrist_camera_link", (0.6, 0.0, 1.0))
    assert (bench.rig.trace(wall(distance=3.0)) == 128).all()
    bench.rig.wait_status("transforms", b"\x01", "lidar_link")


# Lamps of a room


@uses("indoor_lights")
def test_indoor_lights_each_lamp_has_its_own_shadow(bench: Bench) -> None:
    rig = bench.rig
    bench.place("map", "camera", (0.0, 0.5, 4.0), DOWN)
    lamps = {
        "ceiling_left": Lamp((-1.0, 0.0, 2.4)),
        "ceiling_right": Lamp((1.0, 0.0, 2.4)),
        "desk": Lamp((0.0, 1.0, 1.2), angle=0.61, range=2.0),
        "window": Lamp(direction=(0.8, 0.0, -0.6)),
    }
    bench.hear(*lamps)
    plates = [flat(0.0, 0.8, 0.7, 0.25), flat(-0.8, 0.2, 1.0, 0.2)]
    rig.send_mesh(*mesh_of(plates))
    stamp = rig.send_frame(wall(distance=4.0))
    bench.check_lights(stamp, bench.floor(4.0, 0.0, 0.5), lamps, plates)
    assert (rig.mask_of(stamp).ravel()[1:] == 255).all()  # each place is reached by some lamp
    for name in ("ceiling_left", "window"):
        assert rig.set(**{f"lights__{name}__enabled": False}) == ""
    mask = rig.trace(wall(distance=4.0))
    check(mask, bench.floor(4.0, 0.0, 0.5), [lamps["ceiling_right"], lamps["desk"]], plates)
    assert rig.set(lights__desk__position=[0.5, 1.0, 1.2], lights__ceiling_right__enabled=False) == ""
    mask = rig.trace(wall(distance=4.0))
    check(mask, bench.floor(4.0, 0.0, 0.5), [replace(lamps["desk"], position=(0.5, 1.0, 1.2))], plates)


# The robot's own shadow

NORTH = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))  # x y z w of a robot that looks north: a quarter turn from east


def publish_link(bench: Bench, frame: str, half: float) -> None:
    """A square link in its frame, as docs/integration.md publishes the links of a robot."""
    vertices, triangles = mesh_of([flat(0.0, 0.0, 0.0, half)])
    marker = MarkerMessage(ns="robot", frame=frame, frame_locked=True, points=vertices[triangles].reshape(-1, 3))
    bench.rig.send_part("mesh_markers", MarkerArray, encode_markers([marker]))


def from_north(way: Sequence[float]) -> tuple[float, float, float]:
    """A direction, given as east, north, up, in the frame of a robot that looks north: forward, left, up."""
    east, north, up = way
    return north, -east, up


@uses("robot_self_shadow")
def test_robot_self_shadow_is_left_out_wherever_the_robot_and_its_links_are(bench: Bench) -> None:
    pytest.importorskip("ephem", reason="needs ephem: pip install 'shadow_tracer[sun]'")
    place = {"lights__sun__sun__latitude": math.degrees(LATITUDE), "lights__sun__sun__longitude": -110.7919}
    assert bench.rig.set(**place, mask__dilate=0) == ""
    bench.place("base_link", "camera", (0.0, 0.0, 4.0), DOWN)
    publish_link(bench, "mast", 0.4)
    bench.hear("sun")
    depths = bench.rig.collect(Image, "shadow_tracer/depth_lit")
    for number, (x, y) in enumerate([(0.2, -0.1), (-0.5, 0.3)]):
        stamp = NOON + (3600 * 3 + number) * SECOND
        for when in (stamp, stamp + 1):
            bench.move("enu", "base_link", when, (50.0 + number, -20.0, 0.0), NORTH)
            bench.move("base_link", "mast", when, (x, y, 0.6), (0.0, 0.0, 0.0, 1.0))
        left_out = bench.rig.trace(wall(distance=4.0), stamp=stamp)
        assert left_out[0, 0] == 1  # no depth: left out by who asks for 0, kept by who asks for above 127
        sun = Lamp(direction=from_north(sunlight(3.0)))
        check(255 - left_out, bench.floor(4.0), [sun], [flat(x, y, 0.6, 0.4)], bench.bias_at(4.0))
        np.testing.assert_array_equal(bench.rig.mask_of(stamp, "sun"), left_out)
        depth = bench.rig.until(
            lambda stamp=stamp: next((m for m in depths if nanoseconds(m.header.stamp) == stamp), None)
        )
        kept = np.isfinite(np.frombuffer(depth.data, np.float32)).reshape(left_out.shape)
        np.testing.assert_array_equal(kept, left_out == 0)
    assert bench.rig.set(mask__dilate=4) == ""
    wider = bench.rig.trace(wall(distance=4.0), stamp=stamp + 1)
    shadow = np.argwhere(left_out == 255)
    near = np.abs(np.argwhere(np.ones_like(wider))[:, None] - shadow).max(axis=2).min(axis=1).reshape(wider.shape) <= 4
    near[0, 0] = False
    np.testing.assert_array_equal(wider == 255, near)


@uses("robot_self_shadow")
def test_robot_self_shadow_by_night_is_that_of_the_lamp(bench: Bench) -> None:
    pytest.importorskip("ephem", reason="needs ephem: pip install 'shadow_tracer[sun]'")
    bench.place("base_link", "camera", (0.0, 0.0, 4.0), DOWN)
    bench.place("base_link", "mast", (0.3, 0.1, 0.6), (0.0, 0.0, 0.0, 1.0))
    bench.place("enu", "base_link", (0.0, 0.0, 0.0), NORTH)
    publish_link(bench, "mast", 0.2)
    midnight = parse_time("2026-06-21T23:00:00Z")
    assert (bench.rig.trace(wall(distance=4.0), stamp=midnight).ravel()[1:] == 255).all()  # as the page says
    assert bench.rig.set(lights__sun__enabled=False, lights__lamp__enabled=True, mask__dilate=0) == ""
    mask = bench.rig.trace(wall(distance=4.0), stamp=midnight + SECOND)
    check(255 - mask, bench.floor(4.0), [Lamp((0.0, 0.0, 1.5))], [flat(0.3, 0.1, 0.6, 0.2)], bench.bias_at(4.0))


@uses("robot_self_shadow")
def test_robot_self_shadow_without_a_heading_nothing_is_known_and_said(bench: Bench) -> None:
    bench.place("base_link", "camera", (0.0, 0.0, 4.0), DOWN)
    assert (bench.rig.trace(wall(distance=4.0), stamp=NOON) == 1).all()
    bench.rig.wait_status("transforms", b"\x01", "lights.sun.frame")
