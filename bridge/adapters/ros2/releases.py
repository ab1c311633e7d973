"""The releases of ROS 2 on which the ROS 2 side runs, with all their differences that matter to it.

What the side calls by ctypes is the same in Jazzy and Kilted: the headers of rcl, rmw, rcutils and rosidl declare the
same structures (compared: rclpy 7.1.6 with 9.1.2). Lyrical's row follows its sources (rosidl_typesupport_fastrtps and
ros2.repos, branch lyrical); the tests run on Jazzy and Kilted.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_VERSION = re.compile(r"<version[^>]*>\s*(\d+)")


@dataclass(frozen=True, slots=True)
class Release:
    """One release.

    Attributes:
        name: its name, as in ``ROS_DISTRO``.
        rclpy: major version of its rclpy, by which it is recognized.
        python: the Python of its packages for Ubuntu.
        fast_dds: version of its Fast DDS, major and minor, as in the library's name.
        node_arguments: further arguments of rclpy's inner ``Node``, after ``enable_rosout``.
        has_buffers: whether a message's callbacks for Fast DDS end with those for buffers.
    """

    name: str
    rclpy: int
    python: str
    fast_dds: str
    node_arguments: tuple[None, ...]
    has_buffers: bool

    @property
    def fast_dds_major(self) -> int:
        """The major version of Fast DDS; only participants with the same major version share memory."""
        return int(self.fast_dds.partition(".")[0])

    @property
    def profile_variables(self) -> tuple[str, ...]:
        """The variables that name the Fast DDS profile; Fast DDS 3 warns about the variable that Fast DDS 2 needs."""
        return ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")[self.fast_dds_major - 2 :]

    @property
    def writer_times(self) -> tuple[str, str]:
        """The profile's elements for a writer's heartbeat period and NACK suppression, as Fast DDS spells them."""
        if self.fast_dds_major == 2:
            return "heartbeatPeriod", "nackSupressionDuration"
        return "heartbeat_period", "nack_supression_duration"

    @property
    def library(self) -> str:
        """File name of Fast DDS's library."""
        return f"lib{SHARED_MEMORY[self.fast_dds_major]}.so.{self.fast_dds}"

    @property
    def _space(self) -> str:
        """The namespace of Fast DDS's RTPS layer, as in its symbols."""
        space = SHARED_MEMORY[self.fast_dds_major]
        return f"8eprosima{len(space)}{space}4rtps"

    @property
    def new_guid(self) -> str:
        """Symbol of ``RTPSDomainImpl::create_participant_guid(int &, GUID_t &)`` in `library`."""
        return f"_ZN{self._space}14RTPSDomainImpl23create_participant_guidERiRNS1_6GUID_tE"

    @property
    def writer_filter(self) -> tuple[str, str, str, str]:
        """Symbols in `library` for filtering what a writer sends to a reader.

        The virtual functions of ``StatefulWriter``; its ``reader_data_filter``, as a getter and a setter; and
        ``RTPSDomainImpl::find_local_writer(const GUID_t &)``.
        """
        writer = f"{self._space}14StatefulWriter"
        base = "NS_7fastdds4rtps17IReaderDataFilterE" if self.fast_dds_major == 2 else "NS1_17IReaderDataFilterE"
        return (
            f"_ZTVN{writer}E",
            f"_ZNK{writer}18reader_data_filterEv",
            f"_ZN{writer}18reader_data_filterEP{base}",
            f"_ZN{self._space}14RTPSDomainImpl17find_local_writerERKNS1_6GUID_tE",
        )


SHARED_MEMORY = {2: "fastrtps", 3: "fastdds"}
"""The name that Fast DDS gives its library, its namespace and its files in shared memory, by major version."""

RELEASES = (
    Release("jazzy", 7, "3.12", "2.14", (), has_buffers=False),
    Release("kilted", 9, "3.12", "3.2", (None,), has_buffers=False),
    Release("lyrical", 10, "3.14", "3.6", (None,), has_buffers=True),
)


def release_of(prefix: Path) -> Release | None:
    """Return the release that is installed in a prefix, such as ``/opt/ros/jazzy``; None if it is not in the table."""
    try:
        version = _VERSION.search((prefix / "share/rclpy/package.xml").read_text(encoding="utf-8"))
    except OSError:
        return None
    number = int(version[1]) if version else 0
    return next((release for release in RELEASES if release.rclpy == number), None)


@cache
def current() -> Release:
    """Return the release whose rclpy this process imports; raises `ImportError` if none of the table is installed."""
    spec = importlib.util.find_spec("rclpy")
    if spec is None or spec.origin is None:
        raise ImportError("rclpy is not installed")
    prefix = Path(spec.origin).parents[4]  # <prefix>/lib/python3.x/site-packages/rclpy/__init__.py
    release = release_of(prefix)
    if release is None:
        raise ImportError(f"the ROS 2 in {prefix} is none of {names()}")
    return release


def names(releases: Iterable[Release] = RELEASES) -> str:
    """Return the releases' names with their Python: "jazzy (Python 3.12), ..."."""
    return ", ".join(f"{release.name} (Python {release.python})" for release in releases)
