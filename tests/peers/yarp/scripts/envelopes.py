"""Sends stamps as the envelopes of messages."""

import yarp

yarp.Network.init()
out, inp = yarp.BufferedPortVector(), yarp.BufferedPortVector()
out.open("/envelopes/out")
inp.open("/envelopes/in")
inp.setStrict()
yarp.Network.connect("/envelopes/out", "/envelopes/in")

stamp = yarp.Stamp()
for i in range(3):
    stamp.update(100.0 + i / 8)
    out.setEnvelope(stamp)
    vector = out.prepare()
    vector.resize(2)
    vector[0] = i
    out.writeStrict()

got = yarp.Stamp()
for _ in range(3):
    vector = inp.read()
    ok = inp.getEnvelope(got)
    print(vector[0], ok, got.getCount() - stamp.getCount() + 2, got.getTime(), got.isValid())

text = yarp.Bottle("any bottle (is an envelope)")
out.setEnvelope(text)
out.prepare().resize(1)
out.writeStrict()
inp.read()
seen = yarp.Bottle()
print(inp.getEnvelope(seen), seen.toString())
out.close()
inp.close()
yarp.Network.fini()
