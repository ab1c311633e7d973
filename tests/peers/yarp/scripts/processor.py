"""A PortReader handles a port's messages, and replies to requests."""

import yarp

yarp.Network.init()


class Processor(yarp.PortReader):
    def read(self, connection):
        if not connection.isValid():
            print("closing")
            return False
        question, answer = yarp.Bottle(), yarp.Bottle()
        if not question.read(connection):
            return False
        print("from", connection.getRemoteContact().getName(), "came", question.toString())
        writer = connection.getWriter()
        if writer is None:
            return True
        answer.addString("received")
        answer.append(question)
        return answer.write(writer)


server, client = yarp.Port(), yarp.Port()
processor = Processor()
server.setReader(processor)
server.open("/processor")
client.open("/processor/client")
client.addOutput("/processor", "tcp")
reply = yarp.Bottle()
client.write(yarp.Bottle("1 two 3.5"), reply)
print("answered", reply.toString())
client.write(yarp.Bottle("no answer needed"))
client.close()
server.close()
yarp.Network.fini()
