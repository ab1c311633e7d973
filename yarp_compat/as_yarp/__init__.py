"""A folder for ``sys.path`` that makes ``import yarp`` import `yarp_compat`."""
