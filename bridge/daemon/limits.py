"""Limits of the process that its workers inherit."""

from __future__ import annotations

import logging
import sys

logger = logging.getLogger("midspan.daemon")

WANTED_FILES = 1 << 16
"""More than enough: rospy takes about two descriptors for a subscribed topic. Some programs loop over all possible
descriptors, so an "infinite" hard limit is not taken over as it is."""


def raise_open_files() -> int:
    """Raise the soft limit of open files to the hard one, at most `WANTED_FILES`; what is in force, 0 unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = WANTED_FILES if hard == resource.RLIM_INFINITY else min(hard, WANTED_FILES)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return soft
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    except (OSError, ValueError) as err:
        logger.warning("the limit of open files stays at %d: %s", soft, err)
        return soft
    return wanted
