"""Connects to a port, and prints received messages in a callback. Arguments: the other port, the message count."""

import sys

import yarp

yarp.Network.init()


class Printer(yarp.BottleCallback):
    count = 0

    def onRead(self, bottle, reader):
        print(f"{reader.getName()}: {bottle.toString()}", flush=True)
        self.count += 1


port = yarp.BufferedPortBottle()
port.setStrict()
printer = Printer()
port.useCallback(printer)
port.open("/print/bottles:i")
if not yarp.Network.waitPort(sys.argv[1], True) or not yarp.Network.connect(sys.argv[1], port.getName()):
    print("not connected")
    sys.exit(1)
while printer.count < int(sys.argv[2]):
    yarp.delay(0.01)
port.interrupt()
port.close()
yarp.Network.fini()
