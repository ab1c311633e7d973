"""Converts images to numpy and back: a received image is copied into an array, changed there, and sent."""

import numpy as np
import yarp

yarp.Network.init()
WIDTH, HEIGHT = 65, 48  # rows of 195 bytes, which YARP pads to 200

camera, filter_in, filter_out, viewer = (
    yarp.BufferedPortImageRgb(),
    yarp.BufferedPortImageRgb(),
    yarp.Port(),
    yarp.BufferedPortImageRgb(),
)
camera.open("/images/camera:o")
filter_in.open("/images/filter:i")
filter_out.open("/images/filter:o")
viewer.open("/images/view:i")
yarp.Network.connect("/images/camera:o", "/images/filter:i", "udp")
yarp.Network.disconnect("/images/camera:o", "/images/filter:i")
yarp.Network.connect("/images/camera:o", "/images/filter:i")
yarp.Network.connect("/images/filter:o", "/images/view:i")

image = camera.prepare()
image.resize(WIDTH, HEIGHT)
image.zero()
image.pixel(10, 20).r = 255
image.pixel(10, 20).b = 7
camera.write()

array = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
wrapped = yarp.ImageRgb()
wrapped.resize(WIDTH, HEIGHT)
wrapped.setExternal(array, array.shape[1], array.shape[0])

received = filter_in.read()
print("received", received.width(), received.height(), received.getRowSize(), received.getPixelSize())
wrapped.copy(received)
print("red at", [int(i) for i in np.argwhere(array[:, :, 0])[0]], "blue", int(array[20, 10, 2]))

array[:, :] = 255 - array
filter_out.write(wrapped)
seen = viewer.read()
print("inverted", seen.pixel(10, 20).r, seen.pixel(10, 20).g, seen.pixel(10, 20).b, seen.pixel(0, 0).r)

mono, floats = yarp.ImageMono(), yarp.ImageFloat()
mono.resize(8, 4)
mono.zero()
floats.resize(2, 2)
floats.setPixel(1, 1, 2.5)
print("others", mono.getRawImageSize(), floats.getPixel(1, 1))
for port in (camera, filter_in, filter_out, viewer):
    port.close()
yarp.Network.fini()
