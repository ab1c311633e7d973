"""The real master and the real rosout, as roscore starts them, but without its launcher, which takes a second.

Usage: core.py PORT
"""

import os
import subprocess
import sys
import time
import uuid

from rosmaster.main import configure_logging
from rosmaster.master import Master

ROSOUT = "/usr/lib/rosout/rosout"
"""The program's path in Debian's package."""

ME = "/roslaunch"


def main():
    """Run until a signal arrives; rosout is in the same process group, and exits with this process."""
    configure_logging()
    master = Master(int(sys.argv[1]))
    master.start()
    for name, value in {"/rosdistro": "Debian\n", "/rosversion": "1.15.15\n", "/run_id": str(uuid.uuid1())}.items():
        master.handler.setParam(ME, name, value)
    command = ["setpriv", "--pdeathsig", "KILL", ROSOUT, "__name:=rosout"]
    rosout = subprocess.Popen(command, env={**os.environ, "ROS_MASTER_URI": master.uri})
    while master.ok() and rosout.poll() is None:
        time.sleep(0.1)


main()
