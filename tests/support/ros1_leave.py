"""The end of a rospy program of the tests, which spares it half a second in which a thread of rospy's spins.

rospy closes the socket of its XML-RPC server under the thread that polls it, and then waits for another one that ends
with its next turn.
"""

import rospy
from rosgraph.xmlrpc import ThreadingXMLRPCServer


def close_and_end(self):
    """Close the server's socket, and have its thread end in place of polling that."""
    self._BaseServer__shutdown_request = True
    close(self)


close = ThreadingXMLRPCServer.server_close
ThreadingXMLRPCServer.server_close = close_and_end


def leave():
    """Take all back from the master and from the peers, and wait for none of rospy's threads."""
    del rospy.core._shutdown_threads[:]
    rospy.signal_shutdown("end of the test")
