"""A ROS topic between two nodes without ROS, with the classes Node, Publisher and Subscriber, as in C++."""

import yarp

yarp.Network.init()
talker, listener = yarp.Node("/yarp/talker"), None
publisher = yarp.Publisher(yarp.rosmsg.std_msgs.String)
publisher.topic("/chatter")
listener = yarp.Node("/yarp/listener")
subscriber = yarp.Subscriber(yarp.rosmsg.std_msgs.String)
subscriber.topic("/chatter")
print(publisher.getName(), subscriber.getName())
while not publisher.getOutputCount():
    yarp.delay(0.01)
data = yarp.rosmsg.std_msgs.String()
data.data = "Hello from YARP"
publisher.write(data)
received = yarp.rosmsg.std_msgs.String()
subscriber.read(received)
print("received:", received.data)
yarp.Network.fini()
