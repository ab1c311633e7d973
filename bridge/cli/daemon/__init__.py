"""The commands that run the daemon, one worker, one module or the simulator."""
