"""Builds, searches, writes and parses bottles, values and properties."""

import yarp

prop = yarp.Property()
prop.put("name", "r1")
prop.put("wheels", 2)
prop.put("radius", yarp.Value(0.16))
prop.fromString("(LASER (port /laser) (range 0.1 30.0)) (flags (a b c))", False)
print(prop.find("name").asString(), prop.find("wheels").asInt32(), prop.find("radius").asFloat64())
print(prop.check("name"), prop.check("arms"), prop.find("arms").isNull())
print(prop.findGroup("LASER").find("port").asString(), prop.findGroup("LASER").findGroup("range").tail().toString())
prop.unput("name")
print(prop.check("name"))

options = yarp.Property()
options.fromCommand(["program", "--robot", "cer", "--size", "3", "--GENERAL::period", "0.02", "--verbose"])
print(
    options.find("robot").asString(), options.findGroup("GENERAL").find("period").asFloat64(), options.check("verbose")
)

bottle = yarp.Bottle('hello 42 3.5 [set] (a (b 1)) "two words" {1 2 255}')
print(bottle.size(), bottle.get(3).isVocab32(), bottle.get(4).asList().find("b").asInt32(), bottle.get(6).isBlob())
print(bottle.find("hello").asInt32(), bottle.get(9).isNull(), bottle.toString())
again = yarp.Bottle(bottle.toString())
print(
    "same", again.toString() == bottle.toString(), bottle.tail().get(0).asInt32(), bottle.pop().isBlob(), bottle.size()
)
print(yarp.decode(yarp.encode("stop")), yarp.Vocab32.decode(again.get(3).asVocab32()))
value = yarp.Value()
value.fromString("(x 1.5)")
print(value.isList(), value.asList().find("x").asFloat64(), yarp.Value(7).isInt32(), yarp.Value("s").asInt32())
