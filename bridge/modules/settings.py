"""Whether the configuration enables the modules' worker."""

from __future__ import annotations

from bridge.config.model import Config
from bridge.config.sections.section import Enabled


def enabled(config: Config) -> Enabled:
    """Return ``modules.enabled`` if a module or the store needs the worker, else False."""
    return config.modules.enabled if config.hosted or config.store.enabled is True else False
