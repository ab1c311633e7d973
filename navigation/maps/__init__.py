"""Maps as planners take them: pure functions from YARP's flags to grids and masks, and back."""
