"""The section ``modules.localization_server``: the robot's pose for all sides."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field
from typing_extensions import override

from bridge.config.sections.section import (
    FrameName,
    MapSource,
    Mistake,
    ModuleSection,
    OptionalTopic,
    PortName,
    PoseSourceName,
    Section,
    setting,
    subsection,
)

_Deviation = Annotated[float, Field(gt=0.0, lt=1000.0)]
Spread = tuple[_Deviation, _Deviation]  # standard deviations: meters, degrees


class LocalizerSection(Section):
    """Midspan's own localizer: a particle filter on the map's walls."""

    particles: int = setting(1000, "Number of particles, each a possible pose.", ge=50, le=20_000)
    beams: int = setting(360, "Maximum number of beams of a scan that are used.", ge=20, le=2000)
    holonomic: bool = setting(False, "Whether the base can drive sideways.")
    odom_alpha: tuple[Annotated[float, Field(ge=0.0, le=10.0)], ...] = setting(
        (0.1, 0.1, 0.1, 0.1, 0.1),
        "Noise of odometry, like amcl's `odom_alpha1` to `5`: of turning due to turning, of turning due to driving, of"
        " driving due to driving, of driving due to turning, sideways due to driving.",
        min_length=5,
        max_length=5,
    )
    laser_sigma: float = setting(
        0.08, "Standard deviation of the distance between a beam's end and its wall, meters.", gt=0.0, le=1.0
    )
    laser_hit: float = setting(0.9, "Share of beams that end at an object on the map.", gt=0.0, lt=1.0)
    update_min_d: float = setting(0.1, "Meters driven between two updates.", gt=0.0, le=5.0)
    update_min_a: float = setting(5.7, "Degrees turned between two updates.", gt=0.0, le=180.0)
    good: float = setting(
        0.6, "Share of the scan that the map must explain before the robot counts as localized.", gt=0.0, le=1.0
    )
    poor: float = setting(0.4, "If the map explains less than this share, the robot is lost.", ge=0.0, lt=1.0)
    recovery: float = setting(
        4.0, "Distance around the estimate within which better poses are searched for, meters.", gt=0.0, le=50.0
    )


class LocalizationServerSection(ModuleSection):
    """The robot's pose, and its source."""

    source: PoseSourceName | None = setting(
        None,
        "Source of the robot's pose: `own` (Midspan's localizer, by laser and odometry), `amcl` (of ROS 1 or ROS 2),"
        " `tf` (the transform from map to odometry), `topic` (a pose topic), `port` (a YARP port of poses), `server`"
        " (another server of ILocalization2D), or a class of your own as `package.module:Class`; empty:"
        " `navigation.localizer`, or else `own`.",
    )
    options: dict[str, Any] = Field(default_factory=dict, description="Options for a class of your own.")
    map: MapSource | None = setting(
        None, "`store` (its current map), or a topic (`nav_msgs/msg/OccupancyGrid`); empty: `navigation.map`."
    )
    map_frame: FrameName = setting("map", "The frame of maps.")
    odom_frame: FrameName = setting("odom", "The odometry's frame.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    scan: OptionalTopic = setting("/scan", "The laser (`sensor_msgs/msg/LaserScan`), for `own`.")
    initial_pose: tuple[float, float, float] | None = setting(
        None, "For `own`: the robot's start pose: x, y (meters), direction (degrees); empty: unknown."
    )
    initial_spread: Spread = setting(
        (0.5, 15.0), "Standard deviations of a start pose without a covariance: meters, degrees."
    )
    usual_spread: Spread = setting((0.1, 5.0), "Standard deviations of a pose without a covariance: meters, degrees.")
    initialpose: OptionalTopic = setting(
        "/initialpose",
        "Topic of start poses (`PoseWithCovarianceStamped`): `own` subscribes to it, and `setInitialPose` publishes it"
        " for `amcl`.",
    )
    amcl_pose: OptionalTopic = setting("/amcl_pose", "amcl's pose and covariance (`PoseWithCovarianceStamped`).")
    particlecloud: OptionalTopic = setting("/particlecloud", "The particles of ROS 1's amcl (`PoseArray`).")
    particle_cloud: OptionalTopic = setting(
        "/particle_cloud", "The particles of ROS 2's amcl (`nav2_msgs/msg/ParticleCloud`)."
    )
    set_map: OptionalTopic = setting(
        "/set_map", 'amcl\'s service that changes the map (`nav_msgs/srv/SetMap`); "": none.'
    )
    topic: OptionalTopic = setting(
        "/pose", "For `topic`: `PoseWithCovarianceStamped`, `PoseStamped` or `Odometry` in the map's frame."
    )
    pose_age: float = setting(2.0, "Seconds for which a pose stays valid, updated by odometry.", gt=0.0, le=3600.0)
    server: PortName = setting("/otherLocalizer", "For `server`: prefix of the other server's ports.")
    publish_tf: bool = setting(
        True, "Whether to publish the transform from map to odometry on `/tf`; never with `amcl` and `tf`."
    )
    tf_tolerance: float = setting(
        0.5,
        "Seconds by which that transform's stamp is ahead, as with amcl: more than `period` plus the delay until other"
        " programs receive it.",
        ge=0.0,
        le=2.0,
    )
    period: float = setting(0.1, "Seconds between two published poses.", ge=0.01, le=5.0)
    particles_period: float = setting(1.0, "Seconds between two published sets of particles.", ge=0.05, le=60.0)
    ports: tuple[PortName, ...] = setting(
        ("/localization2D_nws_yarp", "/localizationServer"),
        "Prefixes of the YARP ports; each has `rpc`, `streaming:o` and `odometry:o`, like YARP's"
        " `localization2D_nws_yarp`.",
    )
    pose_port: PortName = setting("/localizationServer/pose:i", "For `port`: a `Map2DLocation`, or x, y and degrees.")
    localiser: LocalizerSection = subsection(LocalizerSection, "Settings of the source `own`.")

    @override
    def mistakes(self, config: Any) -> Iterator[Mistake]:
        own = self.localiser
        if own.poor >= own.good:
            yield ("localiser", "poor"), f"{own.poor:g} must be less than 'good' ({own.good:g})"
