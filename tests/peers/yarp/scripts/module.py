"""An RFModule that is configured on the command line, replies to commands and counts its cycles."""

import sys

import yarp


class Counter(yarp.RFModule):
    def configure(self, rf):
        self.setName(rf.check("name", yarp.Value("/counter")).asString())
        self.step = rf.check("step", yarp.Value(1)).asInt32()
        self.period = rf.check("period", yarp.Value(0.01)).asFloat64()
        self.total = 0
        self.rpc = yarp.RpcServer()
        self.attach(self.rpc)
        print("configured", flush=True)
        return self.rpc.open(self.getName("/rpc"))

    def getPeriod(self):
        return self.period

    def updateModule(self):
        self.total += self.step
        return True

    def respond(self, command, reply):
        verb = command.get(0).asString()
        if verb == "total":
            reply.addInt32(self.total)
            return True
        if verb == "step":
            self.step = command.get(1).asInt32()
            reply.addString("ok")
            return True
        return False

    def interruptModule(self):
        print("interrupted", flush=True)
        self.rpc.interrupt()
        return True

    def close(self):
        print("closed", flush=True)
        self.rpc.close()
        return True


if __name__ == "__main__":
    yarp.Network.init()
    if not yarp.Network.checkNetwork():
        sys.exit("no name server")
    rf = yarp.ResourceFinder()
    rf.configure(sys.argv)
    code = Counter().runModule(rf)
    yarp.Network.fini()
    sys.exit(code)
