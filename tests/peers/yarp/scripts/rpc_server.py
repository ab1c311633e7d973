"""Answers requests on a port until a request asks it to stop: ``read`` with a reply, then ``reply``."""

import sys

import yarp

yarp.Network.init()
port = yarp.RpcServer()
if not port.open(sys.argv[1]):
    sys.exit(1)
running = True
while running:
    command, reply = yarp.Bottle(), yarp.Bottle()
    if not port.read(command, True):
        break
    verb = command.get(0).asString()
    if verb == "sum":
        reply.addFloat64(sum(command.get(i).asFloat64() for i in range(1, command.size())))
    elif verb == "reverse":
        elements = [command.get(i).toString() for i in range(1, command.size())]
        answer = reply.addList()
        for element in reversed(elements):
            answer.addString(element)
    elif verb == "stop":
        reply.addVocab32("o", "k")
        running = False
    else:
        reply.addString("unknown")
        reply.append(command)
    port.reply(reply)
port.close()
yarp.Network.fini()
