"""The ``web`` section: the console, a page for people who watch and drive."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, Field, field_validator, model_validator

from bridge.config.sections.listen import PersonName, ServerSection, TokenSection, is_loopback_address, split
from bridge.config.sections.section import FrameName, OptionalTopic, Section, matching, setting

if TYPE_CHECKING:
    from bridge.config.model import Config

_HOST = r"[A-Za-z0-9_](?:[A-Za-z0-9_.-]{0,251}[A-Za-z0-9_])?|[0-9A-Fa-f:.]*:[0-9A-Fa-f:.]*"
_NO_LOGIN = "it has no login; set web.tokens ('midspan web --token NAME' creates one), or web.trusted for certificates"

HostName = Annotated[str, matching(_HOST, "is neither a host name nor an IP address; omit port and scheme")]


_PREFIX = re.compile(r"(?:/[A-Za-z0-9_-][A-Za-z0-9_.-]*)+/?|/?")
_OWN_PATHS = frozenset({
    "login", "logout", "whoami", "socket", "map", "metrics", "healthz", "readyz", "lib", "views",
})  # fmt: skip


def _without_end(prefix: str) -> str:
    """Return a path prefix without the slash at its end; raises `ValueError`."""
    if not _PREFIX.fullmatch(prefix):
        raise ValueError(
            f"{prefix!r} is not a path; write a slash, then letters, digits, '_', '-' and '.', for instance /robot1"
        )
    first = prefix.strip("/").partition("/")[0]
    if first in _OWN_PATHS:
        raise ValueError(f"{prefix!r} is a path of the console itself; use another one, for instance /robot1")
    return prefix.rstrip("/")


class OtherRobot(Section):
    """A robot of ``web.robots``."""

    name: str = Field(description="The robot's label on the map.", min_length=1, max_length=64)
    base_frame: FrameName = Field(description="The robot's frame, for instance `r2/base_link`.")
    path: OptionalTopic = setting("", 'Topic of a path (`nav_msgs/Path`) on the hub; "": no path.')
    radius: float = setting(0.3, "Radius of the disc that the map draws for the robot, meters.", gt=0.0, le=10.0)


class WebSection(ServerSection):
    """The web console."""

    listen: str = setting(
        "127.0.0.1:8480",
        "Address and port of the page; port 0: any. An address that other machines reach (`0.0.0.0:8480`) uses TLS,"
        " with the certificate of `hub.open`, and needs `tokens` or `trusted`; see [the console](console.md).",
    )
    names: tuple[HostName, ...] = setting(
        (),
        "Names and addresses by which browsers open the console, at any port, also through a reverse proxy or a tunnel."
        " With TLS they replace those in the certificate; otherwise they are added to the loopback names.",
    )
    prefix: Annotated[str, AfterValidator(_without_end)] = setting(
        "",
        "Path at which a reverse proxy serves the console, for instance `/robot1`; see"
        " [reverse proxies](console_proxy.md).",
    )
    tokens: dict[PersonName, TokenSection] = setting(
        {}, 'Tokens by name: `anna: {role: drive, sha256: "..."}`; with one, connections on loopback use TLS as well.'
    )
    trusted: tuple[Annotated[str, Field(min_length=1, max_length=64)], ...] = setting(
        (), "Certificates with these names may drive; other certificates of the same authority may watch."
    )
    laser: OptionalTopic = setting("/scan", 'Topic of the laser that the map shows; "": none.')
    layer: OptionalTopic = setting(
        "/mapper3d/layer",
        "Topic of the layer (`nav_msgs/OccupancyGrid`) that the map is tinted with; the obstacles' heights are on the"
        ' topic of this name with the suffix `_heights` (`grid_map_msgs/GridMap`). "": none.',
    )
    path: OptionalTopic = setting("", 'Topic of the path that the map shows; "": the path of the chosen planner.')
    radius: float = setting(0.3, "Radius of the disc that the map draws for the robot, meters.", gt=0.0, le=10.0)
    footprint: tuple[tuple[float, float], ...] = setting(
        (), "Corners of a polygon to draw instead of the disc, x ahead, y to the left, meters: `[[0.4, 0.3], ...]`."
    )
    robots: tuple[OtherRobot, ...] = setting(
        (), "Other robots that the map shows, each in a different color.", max_length=16
    )
    speed: float = setting(0.3, "Maximum speed when driving by hand, m/s.", gt=0.0, le=2.0)
    turn: float = setting(0.6, "Maximum angular speed when driving by hand, rad/s.", gt=0.0, le=3.0)

    @property
    def guarded(self) -> bool:
        """Whether the console requires TLS and a token or certificate."""
        return bool(self.tokens or self.trusted)

    @field_validator("footprint")
    @classmethod
    def _is_a_shape(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if value and not 3 <= len(value) <= 64:
            raise ValueError(f"{len(value)} corners do not make a footprint; write 3 to 64 corners, or none for a disc")
        if any(not math.isfinite(part) or abs(part) > 100.0 for corner in value for part in corner):
            raise ValueError("a corner must be at most 100 meters away")
        return value

    @model_validator(mode="after")
    def _safe(self) -> WebSection:
        address, _ = split(self.listen)
        if not self.guarded and not is_loopback_address(address):
            msg = f"listen: other machines reach {address}, but {_NO_LOGIN}"
            raise ValueError(msg)
        return self


def certificate_keys(config: Config) -> dict[str, Any]:
    """Return the keys of the hub's certificate if the servers of the console and of metrics use it."""
    listener = config.hub.open
    keys = listener.keys, listener.ca, listener.certificate, listener.key
    return {"certificate": keys} if config.section(WebSection).guarded else {}
