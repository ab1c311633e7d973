"""Sends requests to a server. Argument: its port."""

import sys

import yarp

yarp.Network.init()
yarp.Network.waitPort(sys.argv[1], True)
client = yarp.RpcClient()
client.open("/rpc/client")
if not client.addOutput(sys.argv[1]):
    sys.exit(1)
for question in ("sum 1 2.5 3", "reverse a b c", "dance fast", "stop"):
    reply = yarp.Bottle()
    ok = client.write(yarp.Bottle(question), reply)
    print(question, "->", ok, reply.toString())
client.close()
yarp.Network.fini()
