"""Reads only the newest message, then every message."""

import yarp

yarp.Network.init()
out, inp = yarp.BufferedPortBottle(), yarp.BufferedPortBottle()
out.open("/strict/out")
inp.open("/strict/in")
yarp.Network.connect("/strict/out", "/strict/in", "fast_tcp")


def send(count):
    for i in range(count):
        bottle = out.prepare()
        bottle.clear()
        bottle.addInt32(i)
        out.write(True)
    out.waitForWrite()


send(50)
newest = inp.read().get(0).asInt32()
while newest != 49:
    newest = inp.read().get(0).asInt32()
print("newest", newest, "pending", inp.getPendingReads())
print("nothing", inp.read(False))

inp.setStrict()
send(50)
got = [inp.read().get(0).asInt32() for _ in range(50)]
print("strict", got == list(range(50)), "last", inp.lastRead().get(0).asInt32())
out.close()
inp.close()
yarp.Network.fini()
