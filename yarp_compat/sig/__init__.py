"""The signal types: vectors, matrices, images, point clouds, sound. They need numpy."""
