"""Sends numbers on a buffered port until a reader has received all. Arguments: the port, the message count."""

import sys

import yarp

yarp.Network.init()
port = yarp.BufferedPortBottle()
port.open(sys.argv[1])
while port.getOutputCount() == 0:
    yarp.delay(0.01)
for i in range(int(sys.argv[2])):
    bottle = port.prepare()
    bottle.clear()
    bottle.addString("number")
    bottle.addInt32(i)
    port.writeStrict()
port.waitForWrite()
port.close()
yarp.Network.fini()
