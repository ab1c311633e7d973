"""ROS 2 message packages, built from their definitions if no wheel or installation contains them.

>>> prefix = build({"my_msgs": {"msg/Reading.msg": "float64 value"}}, progress=print)  # doctest: +SKIP
>>> activate(prefix)  # doctest: +SKIP
>>> from my_msgs.msg import Reading  # doctest: +SKIP
"""

from bridge.interfaces.builder import build, build_bundled
from bridge.interfaces.cache import activate, environment
from bridge.interfaces.definition import BuildError
from bridge.interfaces.folders import bundled_files, bundled_packages

__all__ = ["BuildError", "activate", "build", "build_bundled", "bundled_files", "bundled_packages", "environment"]
