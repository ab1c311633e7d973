"""The parts of the configuration that the router uses in addition to the parts that every worker uses."""

from __future__ import annotations

from typing import Any

from bridge.config.model import Config
from bridge.config.sections.section import Enabled


def router_enabled(config: Config) -> Enabled:
    """Return whether the daemon runs a router."""
    return config.hub.router


def router_uses(config: Config) -> dict[str, Any]:
    """Return the section ``hub``, and if other machines can join, the rules, on which their access depends."""
    return {"hub": config.hub, **({"routing": config.rules} if config.hub.open.opened else {})}
