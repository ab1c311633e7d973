"""The section ``modules.localization_server``: where the robot is, for all sides."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from bridge.config.sections.module import ModuleSection
from bridge.config.sections.section import Section
from bridge.config.sections.values import ROS2_NAME

_PORT = re.compile(r"(?:/[^\s/\"'*()\[\]{}]+)+")

Source = Literal["own", "amcl", "tf", "topic", "port", "server"]


class LocaliserSection(Section):
    """Midspan's own localiser: a particle filter on the map's walls."""

    particles: int = Field(default=1000, ge=50, le=20_000, description="Guesses that are followed at a time.")
    beams: int = Field(default=360, ge=20, le=2000, description="Beams of a scan that are used, at most.")
    holonomic: bool = Field(default=False, description="Whether the base can go sideways.")
    odom_alpha: tuple[Annotated[float, Field(ge=0.0, le=10.0)], ...] = Field(
        default=(0.1, 0.1, 0.1, 0.1, 0.1),
        min_length=5,
        max_length=5,
        description="How far odometry may be off, as amcl's `odom_alpha1` to `5`: turning by turning, turning by"
        " driving, driving by driving, driving by turning, sideways by driving.",
    )
    laser_sigma: float = Field(
        default=0.08, gt=0.0, le=1.0, description="Standard deviation of a beam's end from its wall, metres."
    )
    laser_hit: float = Field(default=0.9, gt=0.0, lt=1.0, description="Share of beams that end at what the map has.")
    update_min_d: float = Field(default=0.1, gt=0.0, le=5.0, description="Metres driven between two updates.")
    update_min_a: float = Field(default=5.7, gt=0.0, le=180.0, description="Degrees turned between two updates.")
    good: float = Field(
        default=0.6,
        gt=0.0,
        le=1.0,
        description="Share of the scan that the map must explain for the robot to be localised.",
    )
    poor: float = Field(default=0.4, ge=0.0, lt=1.0, description="Share below which the robot is lost.")
    recovery: float = Field(
        default=4.0, gt=0.0, le=50.0, description="Metres around the estimate in which better places are looked for."
    )

    @model_validator(mode="after")
    def _good_is_better_than_poor(self) -> LocaliserSection:
        if self.poor >= self.good:
            raise ValueError(f"'poor' ({self.poor:g}) is to be less than 'good' ({self.good:g})")
        return self


class LocalizationServerSection(ModuleSection):
    """Where the robot is, and who says so."""

    source: Source | None = Field(
        default=None,
        description="Who says where the robot is: `own` (Midspan's localiser, by laser and odometry), `amcl` (of ROS 1"
        " or ROS 2), `tf` (whoever publishes the odometry's frame on the map), `topic` (a pose topic), `port` (a YARP"
        " port of poses), `server` (another server of ILocalization2D); empty: as `navigation.localizer` says, or"
        " `own`.",
    )
    map: str | None = Field(
        default=None,
        description="`store` (the store's current map), or a topic (`nav_msgs/msg/OccupancyGrid`); empty: as"
        " `navigation.map` says.",
    )
    map_frame: str = Field(default="map", min_length=1, max_length=100, description="The frame of maps.")
    odom_frame: str = Field(default="odom", min_length=1, max_length=100, description="The odometry's frame.")
    base_frame: str = Field(default="base_link", min_length=1, max_length=100, description="The robot's frame.")
    scan: str = Field(default="/scan", description="The laser (`sensor_msgs/msg/LaserScan`), for `own`.")
    initial_pose: tuple[float, float, float] | None = Field(
        default=None,
        description="Where the robot is at the start: x, y (metres), direction (degrees); empty: nobody knows yet. It"
        " is told to `own` alone.",
    )
    initial_spread: tuple[float, float] = Field(
        default=(0.5, 15.0),
        description="Standard deviations of a start that is told without a covariance: metres, degrees.",
    )
    usual_spread: tuple[float, float] = Field(
        default=(0.1, 5.0),
        description="Standard deviations of a pose whose source tells no covariance: metres, degrees.",
    )
    initialpose: str = Field(
        default="/initialpose",
        description="Topic on which starts are told (`PoseWithCovarianceStamped`): to `own` from all sides, and to"
        " `amcl` by `setInitialPose`.",
    )
    amcl_pose: str = Field(
        default="/amcl_pose", description="amcl's pose (`PoseWithCovarianceStamped`): of it comes the covariance."
    )
    particlecloud: str = Field(default="/particlecloud", description="The particles of ROS 1's amcl (`PoseArray`).")
    particle_cloud: str = Field(
        default="/particle_cloud", description="Those of ROS 2's (`nav2_msgs/msg/ParticleCloud`)."
    )
    set_map: str = Field(
        default="/set_map",
        description="amcl's service that takes another map (`nav_msgs/srv/SetMap`), since it does not follow the"
        ' topic; "": it is not called.',
    )
    topic: str = Field(
        default="/pose",
        description="For `topic`: `PoseWithCovarianceStamped`, `PoseStamped` or `Odometry`, in the frame of maps.",
    )
    pose_age: float = Field(
        default=2.0,
        gt=0.0,
        le=3600.0,
        description="Seconds for which a pose of `topic`, `port` or `server` holds; odometry carries it on meanwhile.",
    )
    server: str = Field(
        default="/otherLocalizer", description="For `server`: what the ports of that server begin with."
    )
    publish_tf: bool = Field(
        default=True, description="Whether the odometry's frame on the map is on `/tf`; never for `amcl` and `tf`."
    )
    tf_tolerance: float = Field(
        default=0.1, ge=0.0, le=2.0, description="Seconds for which that is published ahead, as amcl does."
    )
    period: float = Field(default=0.1, ge=0.01, le=5.0, description="Seconds between two poses that are told.")
    particles_period: float = Field(default=1.0, ge=0.05, le=60.0, description="Seconds between two sets of particles.")
    ports: tuple[str, ...] = Field(
        default=("/localization2D_nws_yarp", "/localizationServer"),
        description="What its YARP ports begin with; each gets `rpc`, `streaming:o` and `odometry:o`, as YARP's"
        " `localization2D_nws_yarp` has them.",
    )
    pose_port: str = Field(
        default="/localizationServer/pose:i",
        description="For `port`: where a `Map2DLocation`, or x, y and degrees, are written to.",
    )
    localiser: LocaliserSection = Field(default_factory=LocaliserSection, description="For `own`.")

    @field_validator("map", "scan", "initialpose", "amcl_pose", "particlecloud", "particle_cloud", "set_map", "topic")
    @classmethod
    def _is_a_name(cls, value: str | None) -> str | None:
        if value not in (None, "", "store") and not ROS2_NAME.fullmatch(str(value)):
            msg = f"{value!r} is no name: begin it with a slash; letters, digits and underscores make its parts"
            raise ValueError(msg)
        return value

    @field_validator("ports")
    @classmethod
    def _are_ports(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for port in value:
            _port(port)
        return value

    @field_validator("pose_port", "server")
    @classmethod
    def _is_a_port(cls, value: str) -> str:
        return _port(value)

    @field_validator("initial_spread", "usual_spread")
    @classmethod
    def _spreads_are_positive(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not all(0.0 < spread < 1000.0 for spread in value):
            raise ValueError("standard deviations are above 0")
        return value


def _port(value: str) -> str:
    if not _PORT.fullmatch(value):
        msg = f"{value!r} is no name of a YARP port: write it as /localizationServer"
        raise ValueError(msg)
    return value
