"""The section ``zenoh``: the other key dialects on zenoh networks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator
from typing_extensions import override

from bridge.config.sections.hub import zenoh_files
from bridge.config.sections.section import ROS2_NAME, Enabled, Section, SideSection, ZenohDestination, matching, setting

_PLAIN_KEY = re.compile(r"[^\s/*$?#@]+(?:/[^\s/*$?#@]+)*")
_HUB_KEY = re.compile(r"[0-9]+/.+/.+::dds_::.+/RIHS[0-9]{2}_.+")
_TYPE = re.compile(r"[A-Za-z]\w*/(msg|srv)/[A-Za-z]\w*", re.ASCII)
_Type = Annotated[str, matching(_TYPE, "is not a type of ROS 2, such as std_msgs/msg/String or std_srvs/srv/SetBool")]
_USUALLY_LATCHED = ("/tf_static", "/map", "/map_metadata", "/robot_description")


class DialectKey(Section):
    """A key of a dialect whose publishers announce nothing."""

    key: str | None = setting(None, "Only for `json`: the zenoh key, for example `robot/pose`.")
    topic: str | None = setting(None, "The topic, for example `/pose`; default with `json`: a slash and the key.")
    type: _Type = Field(
        description="The message type, spelled as in ROS 2: `geometry_msgs/msg/Pose`; with `json` also a service's:"
        " `std_srvs/srv/SetBool`."
    )
    direction: Literal["in", "out", "both"] = setting(
        "both",
        "Only for `json`: whether the programs on the key publish (`in`), subscribe (`out`), or both. For a service:"
        " whether they serve it (`in`) or call it (`out`).",
    )
    latched: bool = setting(False, "Only for `json`: keep the last message from the key for late joiners.")

    @property
    def hub_topic(self) -> str:
        """The topic's name on the hub."""
        return self.topic if self.topic is not None else f"/{self.key}"

    @property
    def is_service(self) -> bool:
        """Whether the key is a service's."""
        return "/srv/" in self.type

    @field_validator("key")
    @classmethod
    def _key_is_plain(cls, value: str | None) -> str | None:
        if value is not None and not _PLAIN_KEY.fullmatch(value):
            msg = f"{value!r} is not a plain zenoh key: parts between slashes, without blanks and any of * $ ? # @"
            raise ValueError(msg)
        if value is not None and _HUB_KEY.fullmatch(value):
            raise ValueError(f"{value!r} is a key of the hub itself, whose programs exchange CDR, not JSON")
        return value

    @model_validator(mode="after")
    def _topic_is_legal(self) -> DialectKey:
        if (self.topic is not None or self.key is not None) and not ROS2_NAME.fullmatch(self.hub_topic):
            msg = f"{self.hub_topic!r} is not a topic name; give a 'topic' of letters, digits and underscores: /pose"
            raise ValueError(msg)
        if self.is_service and (self.direction == "both" or self.latched):
            msg = f"{self.type} is a service; set 'direction' to in (programs serve it) or out, and remove 'latched'"
            raise ValueError(msg)
        return self


class Dialect(Section):
    """One key dialect that is used on the zenoh network."""

    dialect: Literal["ros2dds", "ros1", "json"] = Field(
        description="`ros2dds`: as zenoh-bridge-ros2dds; `ros1`: as zenoh-bridge-ros1; `json`: JSON on plain keys."
    )
    namespace: str | None = setting(
        None, "Not with `json`: the bridges' own namespace; default `/` (ros2dds) or `*` (ros1: `bridge_namespace`)."
    )
    keys: tuple[DialectKey, ...] = setting(
        (), "With `json`: all its keys. Otherwise: topics whose publishers announce nothing, such as free_fleet's."
    )
    latched: tuple[str, ...] = setting(
        _USUALLY_LATCHED,
        "Only for `ros1`: globs of topics whose last message is kept; that dialect does not mark latched topics.",
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Dialect:
        json = self.dialect == "json"
        for_json = any(key.key is not None or key.direction != "both" or key.latched for key in self.keys)
        topics = [key.hub_topic for key in self.keys]
        if json and self.namespace is not None:
            msg = "JSON keys have no namespace; write it into each key"
        elif json and not self.keys:
            msg = "names no keys: JSON is used only on the keys that are listed here"
        elif json and any(key.key is None for key in self.keys):
            msg = "an entry of keys has no 'key'"
        elif not json and any(key.topic is None for key in self.keys):
            msg = "an entry of keys has no 'topic'"
        elif not json and (for_json or any(key.is_service for key in self.keys)):
            msg = "'key', 'direction', 'latched' and services of an entry of keys are only for json"
        elif len(set(topics)) < len(topics):
            msg = f"names the topic {max(topics, key=topics.count)} twice"
        elif json and len({key.key for key in self.keys}) < len(self.keys):
            msg = "names a key twice"
        elif self.dialect != "ros1" and self.latched != _USUALLY_LATCHED:
            msg = "'latched' here is only for ros1"
        elif self.dialect == "ros2dds" and not re.fullmatch(r"/|(/[A-Za-z_]\w*)+", self.namespace or "/", re.ASCII):
            msg = f"namespace {self.namespace!r} is not a ROS 2 namespace, such as /robot1"
        elif self.dialect == "ros1" and not re.fullmatch(r"\*|[A-Za-z0-9_.-]+", self.namespace or "*", re.ASCII):
            msg = f"namespace {self.namespace!r} is not a single part of a key, such as robot1 or *"
        else:
            return self
        raise ValueError(msg)


class ZenohSection(SideSection):
    """The other key dialects in use on zenoh networks; each is a separate side for the rules.

    The sides are called ``zenoh_ros2dds``, ``zenoh_ros1`` and ``zenoh_json``; ``zenoh`` stands for the hub itself.
    """

    enabled: Enabled = setting("auto", "`auto`: enabled if a dialect is configured.")
    router: ZenohDestination | None = setting(
        None, "Router of another zenoh network, for example `tcp/robot1:7447`; default: the hub's own network."
    )
    zenoh: dict[str, Any] | Path | None = setting(
        None, "zenoh configuration of the sessions there (inline or a file); default: that of the hub's sessions."
    )
    dialects: tuple[Dialect, ...] = setting((), "The dialects on that network; see below.")

    @override
    def named_files(self) -> Iterator[Path]:
        return zenoh_files(self.zenoh)

    @model_validator(mode="after")
    def _once_each(self) -> ZenohSection:
        if self.enabled is True and not self.dialects:
            raise ValueError("enabled is true, but no dialect is configured")
        networks = [(d.dialect, d.namespace, tuple(k.key for k in d.keys if k.key)) for d in self.dialects]
        if len(set(networks)) < len(networks):
            raise ValueError("a dialect is given twice")
        return self
