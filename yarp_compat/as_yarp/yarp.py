"""Makes ``import yarp`` import `yarp_compat` if this folder is on the path, as in child processes of a script."""

import sys

import yarp_compat

sys.modules[__name__] = yarp_compat
