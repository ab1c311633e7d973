"""Two ports in one program: one writes, a thread reads the other."""

import threading

import yarp

yarp.Network.init()

source, sink = yarp.Port(), yarp.Port()
if not (source.open("/ports/source") and sink.open("/ports/sink")):
    raise SystemExit("the ports do not open")
if not yarp.Network.connect(source.getName(), sink.getName()):
    raise SystemExit("the ports do not connect")


def read_all() -> None:
    bottle = yarp.Bottle()
    while sink.read(bottle):
        print("read", bottle.toString())
        if bottle.get(0).asString() == "end":
            return


reader = threading.Thread(target=read_all)
reader.start()

for i in range(3):
    bottle = yarp.Bottle()
    bottle.addString("item")
    bottle.addInt32(i)
    bottle.addFloat64(i / 4)
    inner = bottle.addList()
    inner.addVocab32("set")
    inner.addInt64(10**12)
    source.write(bottle)
source.write(yarp.Bottle("end"))
reader.join()

print("outputs", source.getOutputCount(), "inputs", sink.getInputCount())
yarp.Network.disconnect(source.getName(), sink.getName())
print("connected", yarp.Network.isConnected(source.getName(), sink.getName()))
source.close()
sink.close()
yarp.Network.fini()
