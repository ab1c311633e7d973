"""Tables and drawings for terminals: routes, YARP ports, maps. The verbs and the demos share them."""
