# SPDX-License-Identifier: Apache-2.0
"""Several cameras in one node: one world, one tracer, and none disturbs another."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from camera_rig import NAMES, PLACED, POSES, CameraRig
from harness import FOCAL, HEIGHT, SMALL, WIDTH, Rig, image_msg, info_msg, nanoseconds, plate, reliable, wall
from node_world import BIAS, cloud_msg, library, pose_msg, shift
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Bool

from shadow_tracer import Bias, Camera, PointLight, ShadowTracer
from shadow_tracer.ros.diagnostics import DEPTH, ERROR, MESH, OK, PROCESSING, TRANSFORMS, WARN
from shadow_tracer.ros.node.lifecycle_node import ShadowLifecycleNode
from shadow_tracer.ros.parameters.parameters import ParameterError
from shadow_tracer.testing import Harness

LAMP = PointLight("lamp", (0.5, -0.5, 0.0))
SMALL_WALL = np.full((30, 40), 2.0, np.float32)


@pytest.fixture(scope="module")
def shared() -> Iterator[CameraRig]:
    with CameraRig() as made:
        made.send_mesh(*plate())
        yield made


@pytest.fixture
def rig(shared: CameraRig) -> Iterator[CameraRig]:
    """One node for many tests, with the same parameters at the start of each."""
    yield shared
    back: dict[str, Any] = {f"cameras.{name}.pose": pose for name, pose in POSES.items()}
    back |= {f"cameras.{name}.bias.{key}": -1.0 for name in NAMES for key in ("constant", "quadratic", "normal")}
    back |= {f"cameras.{name}.{key}": value for name in NAMES for key, value in (("rate", 0.0), ("frame", ""))}
    back |= {f"cameras.{name}.transport": "raw" for name in NAMES}
    back |= {"process": "latest", "occluders": "mesh", "pose_source": "parameter", "verify_every": 0}
    assert shared.set_parameters({**back, "dose.parts": [""], "light_names": ["lamp"], "lights.lamp.frame": ""}) == ""


def expected(
    camera: str,
    depth: np.ndarray,
    tracer: ShadowTracer | None = None,
    *,
    bias: Bias = BIAS,
    pose: np.ndarray | None = None,
) -> np.ndarray:
    """What the library says."""
    if tracer is None:
        tracer = library()
        tracer.scene.put("mesh", *plate())
    height, width = depth.shape
    pose = shift(*POSES[camera][:3]) if pose is None else pose
    made = Camera(width, height, FOCAL, FOCAL, (width - 1) / 2, (height - 1) / 2, pose)
    return tracer.trace(depth, made, [LAMP], bias).mask()


def test_each_camera_has_the_masks_it_has_alone(rig: CameraRig) -> None:
    """Other sizes, poses and biases, in turn, while the mesh changes and while the images are what casts shadow."""
    images = {"front": wall(), "rear": SMALL_WALL}
    tracer = library()
    assert rig.set_parameters({"cameras.rear.bias.constant": 0.1}) == ""
    biases = {"front": BIAS, "rear": Bias(0.1, BIAS.quadratic, BIAS.normal)}
    for step in range(4):
        mesh = plate(x=0.05 * (step // 2))
        rig.send_mesh(*mesh)
        tracer.scene.put("mesh", *mesh)
        for name in NAMES if step % 2 else reversed(NAMES):
            image = images[name].copy()
            image[::5] += 0.01 * step
            found = rig.look(name, image)
            np.testing.assert_array_equal(found, expected(name, image, tracer, bias=biases[name]))
            assert (found == 0).sum() > 20
    rig.send_mesh(*plate())
    assert rig.value(PROCESSING, "faults") == "0"


def test_the_surface_of_an_image_casts_shadow_in_that_image(rig: CameraRig) -> None:
    """In that of its camera alone, as with a node for each."""
    box = wall()
    box[12:25, 30:43] = 1.7
    images = {"front": box, "rear": SMALL_WALL}
    with Rig({"occluders": "mesh+depth", "pose_source": "parameter"}) as alone:
        alone.send_mesh(*plate())
        assert rig.set_parameters({"occluders": "mesh+depth"}) == ""
        for _ in range(2):
            for name, image in images.items():
                assert alone.set(camera_pose=POSES[name]) == ""
                np.testing.assert_array_equal(rig.look(name, image), alone.trace(image))


def test_topics_of_cameras_are_under_their_names(rig: CameraRig) -> None:
    assert rig.node is not None
    topics = {publisher.topic_name for publisher in rig.node.publishers}  # the graph may know another node of this name
    of_one = {"mask", "mask/lamp", "camera_info", "light_bits", "overlay", "irradiance", "timing", "depth_lit"}
    of_all = {"scene_markers", "query/visibility", "dose/done", "shadow_grid"}
    assert topics >= {f"/shadow_tracer/{name}/{topic}" for name in NAMES for topic in of_one}
    assert topics >= {f"/shadow_tracer/{topic}" for topic in of_all}
    assert not topics & {f"/shadow_tracer/{topic}" for topic in of_one}
    heard = {subscription.topic_name for subscription in rig.node.subscriptions}
    of_one = {"depth/image_rect", "depth/camera_info", "camera_pose"}
    assert heard >= {f"/{name}/{topic}" for name in NAMES for topic in of_one}
    assert not heard & {f"/{topic}" for topic in of_one}


def test_two_cameras_share_one_scene_and_have_a_set_of_samples_each(rig: CameraRig) -> None:
    for name in NAMES:
        rig.look(name, wall())
    tracer = rig.core.host.made
    assert tracer is not None and set(tracer.sample_sets) == set(NAMES) and tracer.bounds.max_sample_sets == 2
    assert tracer.scene.names == ("mesh",)


def test_none_starves_and_drops_are_counted_for_the_camera_that_has_them(rig: CameraRig) -> None:
    """One camera floods the node, between its images some of the other come: all of these are answered."""
    dropped = {name: rig.core.inputs.cameras[name].queue.dropped for name in NAMES}
    for _ in range(5):
        for _ in range(6):
            rig.send("front", wall())
        stamp = rig.send("rear", SMALL_WALL)
        for _ in range(6):
            last = rig.send("front", wall())
        rig.mask("rear", stamp)
        rig.mask("front", last)
    now = {name: rig.core.inputs.cameras[name].queue.dropped - dropped[name] for name in NAMES}
    assert now["rear"] == 0, now
    rig.until(lambda: rig.number("front", "dropped") == rig.core.inputs.cameras["front"].queue.dropped)
    assert rig.number("rear", "dropped") == rig.core.inputs.cameras["rear"].queue.dropped


def note_order(rig: CameraRig) -> list[tuple[str, int]]:
    """Cameras and stamps of the images answered from now on, in order."""
    order: list[tuple[str, int]] = []
    for name, outputs in rig.core.outputs.cameras.items():
        publish = outputs.timing.publish
        outputs.timing.publish = lambda msg, name=name, publish=publish: (
            order.append((name, nanoseconds(msg.header.stamp))), publish(msg),
        )  # fmt: skip
    return order


def test_turns_go_round_where_both_wait_and_the_newest_is_first(rig: CameraRig) -> None:
    """Both have several images when the tracer is free again."""
    core, order = rig.core, note_order(rig)
    work, core.inputs._work = core.inputs._work, lambda: None
    try:
        stamps = {name: [] for name in NAMES}
        for _ in range(3):
            for name in NAMES:
                before = core.inputs.cameras[name].depth.count
                stamps[name].append(rig.send(name, SMALL_WALL))
                count = before + 1
                rig.until(lambda name=name, count=count: core.inputs.cameras[name].depth.count == count)
                rig.until(lambda name=name: core.inputs.cameras[name].queue._infos._kept.get(stamps[name][-1]))
    finally:
        core.inputs._work = work
    core.wake()
    rig.until(lambda: len(order) >= 2)
    assert {name for name, _ in order[:2]} == set(NAMES)
    assert dict(order[:2]) == {name: stamps[name][-1] for name in NAMES}


def test_a_camera_that_goes_wrong_disturbs_no_other(rig: CameraRig) -> None:
    """Its camera_info is missing, its images are broken, its clock jumps: each is said of it alone."""
    good = rig.look("front", wall())
    cameras, rear = rig.core.inputs.cameras, rig.core.inputs.cameras["rear"].depth
    refused = {name: cameras[name].refused.count for name in NAMES}  # of other tests, too
    unknown, faults = rig.core.health.cameras["front"].unknown, rig.core.health.faults.count
    before, stamp = rear.count, rig.send("rear", wall(), info=False)
    rig.until(lambda: rear.count > before)  # or the next one takes its place
    broken = image_msg(wall(), rig.next_stamp())
    broken.encoding = "rgb8"
    rig.of["rear"]["depth"].publish(broken)
    np.testing.assert_array_equal(rig.look("front", wall()), good)
    rig.mask("rear", stamp)
    rig.until(lambda: rig.number("rear", "refused") == refused["rear"] + 1)
    rig.wait_status(f"{DEPTH} rear", ERROR, "image refused, encoding")
    assert rig.number("front", "refused") == cameras["front"].refused.count == refused["front"]
    jumps = rig.core.health.time_jumps
    for _ in range(2):
        first = rig.stamp
        rig.look("rear", wall(), stamp=first - 5_000_000_000)
        np.testing.assert_array_equal(rig.look("front", wall()), good)
        rig.look("rear", wall())
    assert rig.core.health.time_jumps == jumps
    assert rig.core.health.cameras["front"].unknown == unknown and rig.core.health.faults.count == faults


def test_what_is_missing_is_said_with_the_name_of_the_camera() -> None:
    tf = {"pose_source": "topic", "tf_timeout": 0.0, "mask.unknown_value": 7}
    with CameraRig(tf) as rig:
        rig.send_mesh(*plate())
        pose = rig.publisher(type(pose_msg((0, 0, 0))), "front/camera_pose")
        pose.publish(pose_msg((0.0, 0.0, 0.0)))
        rig.until(lambda: len(rig.core.frames.poses_of["front"]) == 1)
        assert (rig.look("rear", wall()) == 7).all()
        assert (rig.look("front", wall()) == 0).any()
        rig.wait_status(TRANSFORMS, WARN, "camera rear: ")
        rig.wait_status(PROCESSING, WARN, f"camera rear: the last mask says unknown, see {TRANSFORMS!r}")
        assert (rig.look("rear", wall(), info=False) == 7).all()
        rig.wait_status(f"{DEPTH} rear", OK)


def test_when_a_recording_starts_again_all_start_again(rig: CameraRig) -> None:
    jumps = rig.core.health.time_jumps
    for name in NAMES:
        rig.look(name, wall())
    start = rig.stamp - 100_000_000_000
    for k, name in enumerate(NAMES):
        rig.look(name, wall(), stamp=start + k)
    assert rig.core.health.time_jumps == jumps + 1
    for name in NAMES:
        rig.look(name, wall(), stamp=start + 10)


def test_every_image_of_both_is_answered_if_so_wished(rig: CameraRig) -> None:
    assert rig.set_parameters({"process": "every"}) == ""
    rig.connected()
    stamps = {name: [rig.send(name, SMALL_WALL, stamp=rig.stamp + 10 * k + j) for k in range(8)] for j, name in
              enumerate(NAMES)}  # fmt: skip
    for name, sent in stamps.items():
        for stamp in sent:
            rig.mask(name, stamp)
    rig.stamp += 1000


def test_images_that_wait_in_line_have_the_mesh_of_their_time(rig: CameraRig) -> None:
    """Of two cameras in turn: none is first all the time, and the one scene goes forth and back."""
    core, sent, order = rig.core, [], note_order(rig)
    assert rig.set_parameters({"process": "every"}) == ""
    rig.connected()
    work, core.inputs._work = core.inputs._work, lambda: None
    try:
        for step in range(3):
            rig.send_mesh(*plate(x=0.1 * step))
            for name in NAMES:
                before = core.inputs.cameras[name].depth.count
                sent.append((step, name, rig.send(name, wall())))
                rig.until(lambda name=name, before=before: core.inputs.cameras[name].depth.count > before)
    finally:
        core.inputs._work = work
    core.wake()
    masks = {}
    for step, name, stamp in sent:
        tracer = library()
        tracer.scene.put("mesh", *plate(x=0.1 * step))
        masks[step, name] = rig.mask(name, stamp)
        np.testing.assert_array_equal(masks[step, name], expected(name, wall(), tracer))
    assert (masks[0, "rear"] != masks[2, "rear"]).any()
    names = [name for name, _ in order]
    assert names in (["front", "rear"] * 3, ["rear", "front"] * 3)
    rig.send_mesh(*plate())


def test_frames_are_verified_for_each_camera(rig: CameraRig) -> None:
    assert rig.set_parameters({"verify_every": 1}) == ""
    before = {name: rig.core.processors[name].verified for name in NAMES}
    for name in (*NAMES, *NAMES):
        rig.look(name, wall() if name == "front" else SMALL_WALL)
    assert {name: rig.core.processors[name].verified - before[name] for name in NAMES} == dict.fromkeys(NAMES, 2)
    assert all(rig.core.processors[name].differing == 0 for name in NAMES)


def test_queries_and_lights_may_be_in_the_frame_of_any_camera(rig: CameraRig) -> None:
    """Also where no tf says where it is: the node knows the pose of each camera."""
    for name in NAMES:
        rig.look(name, wall(), frame=f"{name}_optical")
    points = np.array([[0.0, 0.0, 2.0], [0.6, 0.6, 2.0], [-0.3, 0.3, 2.0]])
    answers = {frame: rig.ask(cloud_msg(points, rig.stamp, frame)) for frame in ("", "rear_optical", "front_optical")}
    in_world = rig.ask(cloud_msg(points + POSES["rear"][:3], rig.stamp, ""))
    fields = {frame: bytes(cloud.data) for frame, cloud in answers.items()}
    assert fields[""] == fields["front_optical"] and len(set(fields.values())) == 2
    bits = [np.frombuffer(bytes(c.data), np.uint8).reshape(3, -1)[:, 12:] for c in (answers["rear_optical"], in_world)]
    np.testing.assert_array_equal(*bits)
    before = rig.look("front", wall(), frame="front_optical")
    assert rig.set_parameters({"lights.lamp.frame": "rear_optical"}) == ""
    tracer = library()
    tracer.scene.put("mesh", *plate())
    camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    moved = tracer.trace(wall(), camera, [PointLight("lamp", (0.8, -0.4, 0.0))], BIAS).mask()
    after = rig.look("front", wall(), frame="front_optical")
    np.testing.assert_array_equal(after, moved)
    assert (after != before).any()


@pytest.mark.slow
def test_a_dose_counts_while_one_camera_sees_nothing() -> None:
    """An image of which nothing is known begins a pause only if no other camera's are known."""
    given = {"lights.lamp.power": 10.0, "dose.parts": ["mesh"], "dose.side": "both", "dose.max_edge": 1.0}
    with CameraRig(given) as rig:
        rig.send_mesh(*plate())
        done = rig.collect(Bool, "shadow_tracer/dose/done")
        for _ in range(100):
            rig.send("rear", SMALL_WALL, info=False)
            rig.look("front", SMALL_WALL)
            if done:
                break
            rig.settle(0.05)
        assert rig.core.exposure.maps["mesh"].dose.max() > 0.0
        rear = rig.core.health.cameras["rear"]
        assert rear.unknown > 5 and rear.traced == 0
        rig.core.exposure._waiting = 0.5
        rig.mask("rear", rig.send("rear", SMALL_WALL, info=False))
        assert rig.core.exposure._waiting == 0.5
        rig.settle(1.1)  # nothing more comes of the other one
        rig.mask("rear", rig.send("rear", SMALL_WALL, info=False))
        assert rig.core.exposure._waiting == 0.0


# Every parameter of a camera

CHANGES: list[tuple[str, Any, dict[str, Any]]] = [
    ("pose", [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], {}),
    ("bias.constant", 0.9, {}),
    ("bias.quadratic", 0.1, {"bias.constant": 0.5}),
    ("bias.normal", 0.0, {"bias.constant": 0.5}),
]


@pytest.mark.parametrize(("key", "value", "given"), CHANGES, ids=[key for key, _, _ in CHANGES])
def test_a_change_shows_in_the_masks_of_that_camera_alone(
    rig: CameraRig, key: str, value: Any, given: dict[str, Any]
) -> None:
    rough = wall()
    rough[12:25, 30:43] = 1.9
    if given:
        assert rig.set_parameters({f"cameras.rear.{name}": each for name, each in given.items()}) == ""
    before = {name: rig.look(name, rough) for name in NAMES}
    old = rig.node.get_parameter(f"cameras.rear.{key}").value if rig.node else None
    assert rig.set_parameters({f"cameras.rear.{key}": value}) == ""
    assert (rig.look("rear", rough) != before["rear"]).any()
    np.testing.assert_array_equal(rig.look("front", rough), before["front"])
    assert rig.set_parameters({f"cameras.rear.{key}": list(old) if key == "pose" else old}) == ""
    np.testing.assert_array_equal(rig.look("rear", rough), before["rear"])


def test_a_bias_of_minus_one_is_that_of_all(rig: CameraRig) -> None:
    assert rig.set_parameters({"bias.constant": 0.9, "cameras.front.bias.constant": 0.02}) == ""
    try:
        np.testing.assert_array_equal(rig.look("front", wall()), expected("front", wall()))
        bias = Bias(0.9, BIAS.quadratic, BIAS.normal)
        np.testing.assert_array_equal(rig.look("rear", wall()), expected("rear", wall(), bias=bias))
    finally:
        assert rig.set_parameters({"bias.constant": 0.02}) == ""


def test_frame_of_a_camera(rig: CameraRig) -> None:
    """A driver that names the wrong one."""
    rig.look("front", wall())
    rig.look("rear", wall(), frame="wrong")
    points = np.array([[0.0, 0.0, 2.0]])
    assert rig.set_parameters({"cameras.rear.frame": "right"}) == ""
    rig.look("rear", wall(), frame="wrong")
    rig.until(lambda: rig.core.inputs.cameras["rear"].frame == "right")
    unknown = rig.core.queries.unknown
    rig.ask(cloud_msg(points, rig.stamp, "right"))
    assert rig.core.queries.unknown == unknown
    rig.ask(cloud_msg(points, rig.stamp, "wrong"))
    assert rig.core.queries.unknown == unknown + 1


def test_transport_of_a_camera(rig: CameraRig) -> None:
    millimetres = (1000 * np.nan_to_num(wall())).astype(np.uint16)
    good = {name: rig.look(name, millimetres) for name in NAMES}
    assert rig.set_parameters({"cameras.rear.transport": "compressedDepth"}) == ""
    rig.until(rig.of["rear"]["packed"].get_subscription_count)
    np.testing.assert_array_equal(rig.look("rear", millimetres, packed=True), good["rear"])
    np.testing.assert_array_equal(rig.look("front", millimetres), good["front"])
    assert rig.set_parameters({"cameras.rear.transport": "raw"}) == ""
    rig.until(rig.of["rear"]["depth"].get_subscription_count)


def test_rate_of_a_camera(rig: CameraRig) -> None:
    """Of images that come at once the first is answered; of the other camera all are, and both say what they have."""
    before = rig.core.inputs.cameras["rear"].limit.left_out
    assert rig.set_parameters({"cameras.rear.rate": 0.01}) == ""
    first = rig.send("rear", SMALL_WALL)
    rig.mask("rear", first)
    for _ in range(3):
        left = rig.send("rear", SMALL_WALL)
        count = rig.core.inputs.cameras["rear"].depth.count
        rig.until(lambda count=count: rig.core.inputs.cameras["rear"].depth.count > count)
        rig.look("front", SMALL_WALL)
    assert rig.seen("rear", left) is None
    rig.until(lambda: rig.number("rear", "left out by rate") == before + 3)
    assert rig.core.inputs.cameras["front"].limit.left_out == 0
    assert rig.set_parameters({"cameras.rear.rate": 0.0}) == ""
    rig.look("rear", SMALL_WALL)


def test_topics_of_a_camera() -> None:
    topics = {
        "cameras.front.depth_topic": "/left/depth/image",
        "cameras.rear.depth_topic": "right/image_rect",
        "cameras.rear.info_topic": "/elsewhere/info",
        "cameras.rear.pose_topic": "/slam/pose",
    }
    with CameraRig({**topics, "pose_source": "topic", "tf_timeout": 0.0}) as rig:
        rig.send_mesh(*plate())
        for name, topic in (("front", "front/camera_pose"), ("rear", "/slam/pose")):
            publisher = rig.publisher(type(pose_msg((0, 0, 0))), topic)
            publisher.publish(pose_msg(tuple(POSES[name][:3])))
            rig.until(lambda name=name: len(rig.core.frames.poses_of[name]) == 1)
            np.testing.assert_array_equal(rig.look(name, wall()), expected(name, wall()))
        rig.until(lambda: rig.value(f"{DEPTH} rear", "camera_info topic") == "/elsewhere/info")
        assert rig.value(f"{DEPTH} front", "topic") == "/left/depth/image"
        assert rig.value(f"{DEPTH} front", "camera_info topic") == "/left/depth/camera_info"
        for name in ("depth_topic", "info_topic", "pose_topic"):
            reason = rig.set_parameters({f"cameras.rear.{name}": "other"})
            assert reason.startswith(f"cameras.rear.{name} is read-only: each camera has buffers and topics")
        assert rig.set_parameters({"camera_names": ["front"]}).startswith("camera_names is read-only: each camera")


BAD = [
    ("rate", -1.0, "expected double (0 to 1000 Hz), got -1.0"),
    ("rate", math.nan, "expected double (0 to 1000 Hz), got nan"),
    ("transport", "jpeg", "expected string (raw, compressedDepth), got 'jpeg'"),
    ("frame", "/rear", "expected string (a tf frame"),
    ("pose", [0.0, 0.0, 0.0], "expected double array (7 numbers)"),
    ("pose", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5], "expected a unit quaternion"),
    ("bias.constant", -0.5, "expected -1 (as bias.constant) or at least 0, got -0.5"),
    ("bias.quadratic", 0.2, "expected double (-1 to 0.1 1/m), got 0.2"),
    ("bias.normal", math.inf, "expected double (-1 to 2), got inf"),
]


@pytest.mark.parametrize(("key", "value", "reason"), BAD, ids=[f"{key}={value}" for key, value, _ in BAD])
def test_bad_values_are_refused_and_change_nothing(rig: CameraRig, key: str, value: Any, reason: str) -> None:
    settings = rig.core.settings
    assert rig.set_parameters({f"cameras.rear.{key}": value}).startswith(f"cameras.rear.{key}: {reason}")
    assert rig.core.settings is settings


def test_a_camera_that_there_is_not(rig: CameraRig) -> None:
    assert "'left' is not in camera_names ['front', 'rear']" in rig.set_parameters({"cameras.left.rate": 1.0})
    assert "did you mean cameras.rear.rate?" in rig.set_parameters({"cameras.rear.rat": 1.0})


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"pose_source": "tf"}, "fixed_frame: expected the frame in which the cameras front, rear and the lights are"),
        ({"camera_names": ["a", "a"]}, "camera_names: expected different names"),
        ({"cameras.front.depth_topic": "a b"}, "cameras.front.depth_topic: expected string (a topic such as"),
        ({"cameras.front.rate": 2000.0, "cameras.rear.frame": "a b"}, "cameras.rear.frame: expected string"),
    ],
)
def test_what_keeps_a_node_from_starting(given: dict[str, Any], reason: str) -> None:
    with CameraRig(start=False) as rig, pytest.raises(ParameterError) as caught:
        rig.start(given)
    assert reason in str(caught.value)


def test_one_camera_with_a_name_needs_nothing_more() -> None:
    """Not even a fixed frame: the world is its optical frame, as of one without a name."""
    with Rig(start=False) as rig:
        depth = rig.friend.create_publisher(Image, "front/depth/image_rect", reliable())
        del depth
        rig.start({"camera_names": ["front"]}, wait=False)
        rig.until(lambda: rig.node and rig.node.ready, 120.0)
        assert rig.core.inputs.topic("depth front") == "/front/depth/image_rect"
        rig.until(lambda: rig.value(PROCESSING, "traced") == "0")
        rig.wait_status(f"{DEPTH} front", WARN, "or set cameras.front.depth_topic to the topic of the camera")


def test_the_harness_with_cameras_as_its_page_says() -> None:
    with Harness({**SMALL, **PLACED}) as harness:
        publishers = [harness.publisher(kind, f"rear/depth/{name}") for kind, name in ((CameraInfo, "camera_info"),
                      (Image, "image_rect"))]  # fmt: skip
        masks = harness.collect(Image, "shadow_tracer/rear/mask")
        harness.send_mesh(*plate())
        publishers[0].publish(info_msg(WIDTH, HEIGHT, 5))
        publishers[1].publish(image_msg(wall(), 5))
        harness.until(lambda: bool(masks))
        found = np.frombuffer(masks[0].data, np.uint8).reshape(HEIGHT, WIDTH)
        np.testing.assert_array_equal(found, expected("rear", wall()))


def test_the_log_of_a_camera_is_not_held_back_by_that_of_another(capfd: pytest.CaptureFixture[str]) -> None:
    with CameraRig({"camera_info_policy": "exact", "tf_timeout": 0.0}) as rig:
        for name in NAMES:
            rig.look(name, wall(), info=False)
    log = "".join(capfd.readouterr())
    assert all(f"[shadow_tracer.{name}]: mask unknown: no camera_info" in log for name in NAMES)


def test_the_managed_node_with_two_cameras() -> None:
    with CameraRig(start=False) as rig:
        node = rig.start(kind=ShadowLifecycleNode, wait=False)
        rig.until(lambda: rig.status(MESH))
        node.trigger_configure()
        for _ in range(2):
            node.trigger_activate()
            rig.connected()
            for name in NAMES:
                assert rig.look(name, wall()).any()
            node.trigger_deactivate()
            assert not rig.core.inputs.subscriptions
        node.trigger_cleanup()


SHOWN = {
    "depth_topic": test_topics_of_a_camera,
    "info_topic": test_topics_of_a_camera,
    "pose_topic": test_topics_of_a_camera,
    "transport": test_transport_of_a_camera,
    "frame": test_frame_of_a_camera,
    "rate": test_rate_of_a_camera,
    **{key: test_a_change_shows_in_the_masks_of_that_camera_alone for key, _, _ in CHANGES},
}
