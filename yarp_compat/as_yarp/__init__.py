"""A folder for ``sys.path``, in which ``import yarp`` finds this package."""
