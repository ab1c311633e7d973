"""The demo ``topics``: real programs of every side publish, subscribe and drive, and every bridged topic is checked."""
