"""ROS 2 message packages: built from their definitions where no wheel or installation brings them.

>>> prefix = build({"my_msgs": {"msg/Reading.msg": "float64 value"}}, progress=print)  # doctest: +SKIP
>>> activate(prefix)  # doctest: +SKIP
>>> from my_msgs.msg import Reading  # doctest: +SKIP
"""

from bridge.interfaces.builder import build, build_standing
from bridge.interfaces.errors import BuildError
from bridge.interfaces.paths import activate, environment
from bridge.interfaces.standing import standing_files, standing_packages

__all__ = ["BuildError", "activate", "build", "build_standing", "environment", "standing_files", "standing_packages"]
