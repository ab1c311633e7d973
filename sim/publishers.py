"""The simulator's publishers."""

from __future__ import annotations

from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.modules.host import ModuleNode
from sim import messages
from sim.base import TICK_NS, BasePose, Twist
from sim.messages import TopicNames
from sim.simulation import Simulation

_PICTURE = Qos(depth=2)  # large messages, of which only the newest count
_ODOMETRY, _BUMPER, _BATTERY = 2, 10, 100  # ticks between two messages, at 100 ticks per second

_PLACE, _STILL = BasePose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0)
_MOTION = "header.stamp", "pose.pose", "twist.twist"


class SimPublishers:
    """The simulator's publishers.

    Args:
        clock: whether to publish ``/clock``.
    """

    def __init__(self, node: ModuleNode, names: TopicNames, simulation: Simulation, *, clock: bool) -> None:
        self._names, self._simulation = names, simulation
        section = simulation.section
        self._joints = node.publisher(names.joints, "sensor_msgs/msg/JointState")
        self._scan = node.publisher(names.scan, "sensor_msgs/msg/LaserScan")
        self._truth = node.publisher(names.truth, "nav_msgs/msg/Odometry")
        self._battery = node.publisher(names.battery, "sensor_msgs/msg/BatteryState")
        self._bumper = node.publisher(names.bumper, "std_msgs/msg/Bool")
        self._static = node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED, priority="state")
        self._odometry = OdometryPublishers(node, names, simulation) if section.drive == "velocity" else None
        self._clock = node.publisher(CLOCK_TOPIC, CLOCK_TYPE) if clock else None
        self._view = ViewPublisher(node, names.view, simulation, section.view) if section.view else None
        self._camera = CameraPublishers(node, simulation) if simulation.section.camera.rate else None
        self._ticks = 0
        self._scanned = -1
        self._bumped = False
        self._prepare()

    def _prepare(self) -> None:
        """Encode templates of the frequent messages, in which later only the numbers are filled in."""
        names, simulation = self._names, self._simulation
        joints = messages.joints(0, simulation.base.names, simulation.wheels.motors.encoders())
        self._joints_template = self._joints.template(joints, "header.stamp", "position", "velocity")
        truth = messages.odometry(0, _PLACE, _STILL, names.map_frame, names.base_frame, sure=True)
        self._truth_template = self._truth.template(truth, *_MOTION)

    def begin(self, time_ns: int) -> None:
        """Publish the static transforms."""
        names, robot = self._names, self._simulation.robot
        middle = robot.wheels.radius if robot.kinematics == "differential" else 0.0
        camera = None if self._simulation.camera is None else self._simulation.section.camera
        frames = names.base_frame, names.laser_frame
        self._static.publish(messages.mount(time_ns, *frames, robot.lasers.height, camera, middle))

    def publish(self, time_ns: int) -> None:
        """Publish the messages that are due after a tick, stamped ``time_ns``."""
        simulation, names = self._simulation, self._names
        self._ticks += 1
        if "encoders_silent" not in simulation.faults:
            motors = simulation.wheels.motors
            self._joints.offer(lambda: self._joints_template.fill(*messages.joint_numbers(time_ns, motors.encoders())))
        if self._ticks % _ODOMETRY == 0:
            self._publish_pose(time_ns)
        if simulation.scan.time_ns != self._scanned:
            self._scanned = simulation.scan.time_ns
            rate = simulation.section.laser.rate
            scan, frame = simulation.scan, names.laser_frame
            self._scan.offer(lambda: self._scan.encoded(messages.scan(time_ns, scan, frame, rate)))
        if self._camera is not None and simulation.pictured == simulation.time_ns:
            self._camera.publish(time_ns)
        bumped = bool(simulation.bumps)
        if bumped != self._bumped or self._ticks % _BUMPER == 0:
            self._bumped = bumped
            self._bumper.offer(lambda: self._bumper.encoded({"data": bumped}))
        if self._ticks % _BATTERY == 0:
            self._battery.publish(messages.battery(time_ns, simulation.battery.charge))
        if self._view is not None and self._ticks % self._view.every == 0:
            self._view.publish(time_ns)
        if self._clock is not None:
            # last, and at the same priority, so that a tick's measurements arrive before its clock message
            self._clock.publish({"clock": messages.stamp(time_ns)})

    def _publish_pose(self, time_ns: int) -> None:
        base, numbers = self._simulation.base, messages.odometry_numbers
        self._truth.offer(lambda: self._truth_template.fill(*numbers(time_ns, base.pose(), base.twist())))
        if self._odometry is not None and "encoders_silent" not in self._simulation.faults:
            self._odometry.publish(time_ns)


class OdometryPublishers:
    """The publishers of a base's own odometry, and of its transform."""

    def __init__(self, node: ModuleNode, names: TopicNames, simulation: Simulation) -> None:
        self._simulation = simulation
        self._odometry = node.publisher(names.odometry, "nav_msgs/msg/Odometry")
        self._tf = node.publisher("/tf", "tf2_msgs/msg/TFMessage")
        odometry = messages.odometry(0, _PLACE, _STILL, names.odom_frame, names.base_frame)
        self._odometry_template = self._odometry.template(odometry, *_MOTION)
        frame = messages.transform(0, names.odom_frame, names.base_frame, _PLACE)
        self._tf_template = self._tf.template(frame, "transforms[0].header.stamp", "transforms[0].transform")

    def publish(self, time_ns: int) -> None:
        """Publish the estimated pose, stamped ``time_ns``."""
        estimate = self._simulation.estimate
        pose, twist = estimate.pose, estimate.twist
        self._odometry.offer(lambda: self._odometry_template.fill(*messages.odometry_numbers(time_ns, pose, twist)))
        self._tf.offer(lambda: self._tf_template.fill(*messages.transform_numbers(time_ns, pose)))


class ViewPublisher:
    """The publisher of drawings of the simulated world.

    Attributes:
        every: ticks between two drawings.
    """

    def __init__(self, node: ModuleNode, topic: str, simulation: Simulation, rate: float) -> None:
        self._simulation = simulation
        self._view = node.publisher(topic, "sensor_msgs/msg/Image")
        self.every = max(1, round(1e9 / rate / TICK_NS))

    def publish(self, time_ns: int) -> None:
        """Publish a drawing, stamped ``time_ns``."""
        from sim.export import draw

        self._view.offer(lambda: self._view.encoded(messages.image(time_ns, draw(self._simulation))))


class CameraPublishers:
    """The depth camera's publishers; pictures are computed only for subscribers."""

    def __init__(self, node: ModuleNode, simulation: Simulation) -> None:
        self._simulation = simulation
        self._depth = node.publisher(messages.DEPTH, "sensor_msgs/msg/Image", _PICTURE)
        self._info = node.publisher(messages.DEPTH_INFO, "sensor_msgs/msg/CameraInfo")
        self._points = node.publisher(messages.DEPTH_POINTS, "sensor_msgs/msg/PointCloud2", _PICTURE)

    def publish(self, time_ns: int) -> None:
        """Publish the latest picture, stamped ``time_ns``."""
        simulation, camera = self._simulation, self._simulation.camera
        assert camera is not None
        depth, info, points, encoding = self._depth, self._info, self._points, simulation.section.camera.encoding
        info.offer(lambda: info.encoded(messages.camera_info(time_ns, camera.lens, *camera.size)))
        depth.offer(lambda: depth.encoded(messages.depth(time_ns, simulation.depth(), encoding)))
        points.offer(lambda: points.encoded(messages.points(time_ns, camera.points(simulation.depth()))))
