"""Whether the configuration enables the worker of the modules."""

from __future__ import annotations

from bridge.config.model import Config
from bridge.config.sections.section import Enabled


def enabled(config: Config) -> Enabled:
    """Return whether a module or the store needs the worker, unless ``modules.enabled`` switches it off."""
    return config.modules.enabled if config.hosted or config.store.enabled is True else False
