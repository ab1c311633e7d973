"""Finds its configuration and another file, and uses command line arguments."""

import sys

import yarp

yarp.Network.init()
rf = yarp.ResourceFinder()
rf.setDefaultContext("kitchen")
rf.setDefaultConfigFile("robot.ini")
rf.setDefault("period", "0.1")
if not rf.configure(sys.argv):
    sys.exit("no configuration")
print("robot", rf.find("robot").asString())
print("period", rf.check("period", yarp.Value(9.0)).asFloat64())
print("speed", rf.check("speed", yarp.Value(0.25)).asFloat64())
laser = rf.findGroup("LASER")
print("laser", laser.find("port").asString(), laser.find("range").asList().toString())
print("sonar", rf.findGroup("SONAR").isNull())
print("map", rf.findFile("map"))
print("absent", repr(rf.findFileByName("absent.txt")))
print("home", rf.getHomeContextPath())
yarp.Network.fini()
