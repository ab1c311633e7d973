"""Queries and commands that a program sends to the network about other programs' ports."""

import yarp

yarp.Network.init()
print("server", yarp.Network.checkNetwork(), yarp.Network.getNameServerName())
first, second = yarp.Port(), yarp.BufferedPortBottle()
first.open("/tools/one")
second.open("/tools/two")
where = yarp.Network.queryName("/tools/one")
print("where", where.getName(), where.getCarrier(), where.getHost() == first.where().getHost(), where.isValid())
print("exists", yarp.Network.exists("/tools/one"), yarp.Network.exists("/tools/none"), yarp.Network.sync("/tools/two"))
style = yarp.ContactStyle()
style.carrier = "fast_tcp"
print(
    "connect",
    yarp.Network.connect("/tools/one", "/tools/two", style),
    yarp.Network.isConnected("/tools/one", "/tools/two"),
)
print("again", yarp.Network.connect("/tools/one", "/tools/two"), first.getOutputCount())
print("missing", yarp.Network.connect("/tools/one", "/tools/none"))
print("property", yarp.Network.setProperty("/tools/one", "color", yarp.Value("red")))
print("color", yarp.Network.getProperty("/tools/one", "color").asString())
reply = yarp.Bottle()
print(
    "admin", yarp.Network.write(yarp.Contact("/tools/one"), yarp.Bottle("[list] [out]"), reply, True), reply.toString()
)
second.close()
while first.getOutputCount():
    yarp.delay(0.01)
print("gone", yarp.Network.isConnected("/tools/one", "/tools/two"), yarp.Network.exists("/tools/two"))
first.close()
yarp.Network.fini()
