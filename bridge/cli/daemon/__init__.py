"""The commands that run or use the daemon and its workers: ``run``, ``worker``, ``module``, ``record`` and others."""
