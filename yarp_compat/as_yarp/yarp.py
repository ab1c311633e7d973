"""``import yarp`` is ``import yarp_compat`` where this folder is on the path, as in child processes of a script."""

import sys

import yarp_compat

sys.modules[__name__] = yarp_compat
