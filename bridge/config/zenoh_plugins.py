"""The settings of zenoh's plugins, which the files of other bridges contain, and what to write instead of them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

_MIGRATING = "see docs/start/migrating.md"


def replacement(name: str, settings: Mapping[str, Any]) -> str:
    """Return what to write in Midspan's configuration instead of the settings of a zenoh plugin."""
    if name == "ros2dds":
        return _bridge("zenoh-bridge-ros2dds", name, settings, "namespace")
    if name == "ros1":
        return _bridge("zenoh-bridge-ros1", name, settings, "bridge_namespace")
    if name == "dds":
        return (
            "is for zenoh-bridge-dds, whose keys Midspan does not use; run zenoh-bridge-ros2dds on the robot, and write"
            f" 'zenoh: {{dialects: [{{dialect: ros2dds}}]}}' in Midspan's file instead of 'plugins'; {_MIGRATING}"
        )
    return (
        f"Midspan's sessions load no plugins; run zenohd with {name!r}, connect it to hub.listen, and leave it out here"
    )


def _bridge(program: str, dialect: str, settings: Mapping[str, Any], namespace: str) -> str:
    """Return the problem's text: what to write in Midspan's file instead of the settings of a bridge's plugin."""
    given = settings.get(namespace)
    space = f", namespace: {given}" if isinstance(given, str) and re.fullmatch(r"/?[\w./-]+", given) else ""
    write = [f"'zenoh: {{dialects: [{{dialect: {dialect}{space}}}]}}'"]
    if isinstance(domain := settings.get("domain"), int):
        write.append(f"'ros2: {{domain: {domain}}}'")
    if isinstance(master := settings.get("ros_master_uri"), str):
        write.append(f"'ros1: {{master: {json.dumps(master)}}}'")
    side = f"zenoh_{dialect}"
    lists = [key for key in ("allow", "deny", "pub_max_frequencies", "pub_priorities") if settings.get(key)]
    rules = f", and replace its {', '.join(lists)} by rules with 'from: {side}' or 'to: {side}'" if lists else ""
    return (
        f"is for {program}, whose keys Midspan itself uses; instead of 'plugins' write {' and '.join(write)} in"
        f" Midspan's file{rules}; {_MIGRATING}"
    )
