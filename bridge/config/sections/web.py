"""The section ``web``: the console, a page for people who watch and drive."""

from __future__ import annotations

import ipaddress
import re

from pydantic import Field, field_validator

from bridge.config.sections.section import FrameName, OptionalTopic, Section, setting

_ADDRESS = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[^\[\]:/\s]+)):(?P<port>\d{1,5})")


class OtherRobot(Section):
    """A robot of ``web.robots``."""

    name: str = Field(description="What the map writes beside it.", min_length=1, max_length=64)
    base_frame: FrameName = Field(description="Its frame, for instance `r2/base_link`.")
    path: OptionalTopic = setting("", 'Topic of its path (`nav_msgs/Path`) on the hub; "": none is drawn.')
    radius: float = setting(0.3, "Metres: the disc that the map draws for it.", gt=0.0, le=10.0)


class WebSection(Section):
    """The console."""

    enabled: bool = setting(False, "Whether it runs.")
    listen: str = setting(
        "127.0.0.1:8480", "Address and port of the page, of this machine alone (127.0.0.0/8 or [::1]); port 0: any."
    )
    laser: OptionalTopic = setting("/scan", 'Topic of the laser that the map shows; "": none.')
    path: OptionalTopic = setting("", 'Topic of the path that the map shows; "": that of the chosen planner.')
    radius: float = setting(0.3, "Metres: the disc that the map draws for the robot.", gt=0.0, le=10.0)
    robots: tuple[OtherRobot, ...] = setting(
        (), "Other robots that the map shows, each in a colour of its own.", max_length=16
    )
    speed: float = setting(0.3, "m/s that driving by hand commands at the most.", gt=0.0, le=2.0)
    turn: float = setting(0.6, "rad/s that driving by hand commands at the most.", gt=0.0, le=3.0)

    @field_validator("listen")
    @classmethod
    def _listens_here(cls, value: str) -> str:
        address, _ = split(value)
        if address != "localhost" and not _is_loopback(address):
            msg = f"{address} is no address of this machine alone: the console has neither TLS nor tokens yet"
            raise ValueError(msg)
        return value


def split(listen: str) -> tuple[str, int]:
    """Address and port; raises `ValueError`."""
    found = _ADDRESS.fullmatch(listen)
    if found is None or int(found["port"]) > 65535:
        msg = f"{listen!r} is no address and port: write it as 127.0.0.1:8480 or [::1]:8480"
        raise ValueError(msg)
    return found["six"] or found["name"], int(found["port"])


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False
