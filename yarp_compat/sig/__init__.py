"""The signal types: vectors, matrices, images, point clouds, sound. Each is in the file of its name; all need numpy."""
