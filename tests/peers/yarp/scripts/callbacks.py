"""Callbacks for vectors and matrices: as objects, and as the port's own method."""

import yarp

yarp.Network.init()
received = []


class OnVector(yarp.VectorCallback):
    def onRead(self, vector, reader):
        received.append(f"{reader.getName()} {vector.size()} {vector.get(1)}")


class MatrixPort(yarp.BufferedPortMatrix):
    def onRead(self, matrix):
        received.append(f"matrix {matrix.rows()}x{matrix.cols()} {matrix[1, 0]}")


vectors_in, vectors_out = yarp.BufferedPortVector(), yarp.BufferedPortVector()
matrices_in, matrices_out = MatrixPort(), yarp.BufferedPortMatrix()
vectors_in.open("/callbacks/vectors:i")
vectors_out.open("/callbacks/vectors:o")
matrices_in.open("/callbacks/matrices:i")
matrices_out.open("/callbacks/matrices:o")
on_vector = OnVector()
vectors_in.useCallback(on_vector)
matrices_in.useCallback()
yarp.Network.connect("/callbacks/vectors:o", "/callbacks/vectors:i")
yarp.Network.connect("/callbacks/matrices:o", "/callbacks/matrices:i")

vector = vectors_out.prepare()
vector.resize(3)
vector[0], vector[1], vector[2] = 0.5, 1.5, 2.5
vectors_out.write()
matrix = matrices_out.prepare()
matrix.resize(2, 2)
matrix.zero()
matrix.set(0, 1, 1)
matrix[1, 0] = 4
matrices_out.write()

while len(received) < 2:
    yarp.delay(0.01)
print("\n".join(sorted(received)))
for port in (vectors_in, vectors_out, matrices_in, matrices_out):
    port.interrupt()
    port.close()
yarp.Network.fini()
