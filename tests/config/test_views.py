"""The views in configs/ that name YARP ports; views of topics are compared with a deployment (`test_navigation`)."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from bridge.config.model import Config
from navigation.mapper2d.section import Mapper2DSection
from navigation.robot_path_planner.section import RobotPathPlannerSection

VIEW = Path(__file__).parents[2] / "configs" / "views" / "navigation_yarpmanager.xml"


def test_yarpmanager_connects_only_existing_ports() -> None:
    application = ET.parse(VIEW).getroot()
    config, ports = Config(), set[str]()
    for prefix in (config.section(RobotPathPlannerSection).prefix, config.section(Mapper2DSection).prefix):
        ports |= {f"{prefix}/map:o", f"{prefix}/yarpviewTarget:i"}
    for module in application.iter("module"):
        texts = (module.findtext("parameters") or "").split()
        ports |= {texts[texts.index("--name") + 1], texts[texts.index("--out") + 1]}
    named = {
        end.text for connection in application.iter("connection") for end in connection if end.tag in ("from", "to")
    }
    assert named == ports
