"""The file of a user's Fast DDS profile (``ros2.profile``); loads no ROS code, as the daemon checks the file."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET


def read(own: Path) -> ET.Element:
    """Return a profile without namespaces; raises `ValueError` or `OSError`."""
    try:
        root = ET.fromstring(own.read_bytes())  # noqa: S314 - a file that the configuration names
    except ET.ParseError as err:
        raise ValueError(f"{own} is not XML: {err}") from None
    for element in root.iter():
        # Fast DDS ignores the namespace, and ElementTree does not write it as the default one.
        element.tag = element.tag.rpartition("}")[2]
    return root


def default_participant(root: ET.Element) -> ET.Element | None:
    """Return the ``<rtps>`` element of the default participant."""
    for participant in root.iter("participant"):
        rtps = participant.find("rtps")
        if participant.get("is_default_profile") == "true" and rtps is not None:
            return rtps
    return None


def whole(own: Path) -> tuple[ET.Element, ET.Element]:
    """Return a profile, and the ``<rtps>`` element of its default participant; raises `ValueError` or `OSError`."""
    root = read(own)
    rtps = default_participant(root)
    if rtps is None:
        raise ValueError(f'{own} has no <participant is_default_profile="true"> with an <rtps> element')
    return root, rtps


def mistake(own: Path) -> str:
    """Return why a profile cannot be used, "" if it can."""
    try:
        whole(own)
    except OSError as err:
        return f"cannot read {own}: {err.strerror}"
    except ValueError as err:
        return str(err)
    return ""
