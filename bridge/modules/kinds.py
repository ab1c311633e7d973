"""The modules that there are, by their names in the configuration."""

from __future__ import annotations

import importlib

from bridge.config.sections.modules import OwnModule
from bridge.config.sections.section import Section
from bridge.modules.module import Module

KINDS: dict[str, str] = {
    "base_control": "navigation.base_control.module:BaseControl",
    "gateway": "navigation.gateway.module:GatewayModule",
    "localization_server": "navigation.localization_server.module:LocalizationServer",
    "map2d_server": "navigation.map2d_server.module:Map2DServer",
    "mapper2d": "navigation.mapper2d.module:Mapper2D",
    "robot_goto": "navigation.robot_goto.module:RobotGoto",
    "robot_path_planner": "navigation.robot_path_planner.module:RobotPathPlanner",
    "transform_server": "bridge.tf.server.module:TransformServer",
}
"""``package.module:Class`` of each module that comes with Midspan; imported in the process that runs it alone."""


def kind_of(name: str, section: Section) -> type[Module]:
    """A module's class.

    Raises:
        RuntimeError: it cannot be imported, or is none; the text says why.
    """
    factory = section.factory if isinstance(section, OwnModule) else KINDS[name]
    package, _, class_name = factory.partition(":")
    try:
        kind = getattr(importlib.import_module(package), class_name)
    except (ImportError, AttributeError) as err:
        msg = f"modules.{name}: {factory} cannot be imported: {err}"
        raise RuntimeError(msg) from None
    if not (isinstance(kind, type) and issubclass(kind, Module)):
        msg = f"modules.{name}: {factory} is no module: it does not derive from bridge.modules.module.Module"
        raise RuntimeError(msg)  # noqa: TRY004 - the configuration's fault, told as all of these are
    return kind
