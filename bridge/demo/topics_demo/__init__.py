"""The demo ``topics``: real programs of every side publish, listen and drive, and all that crosses is checked."""
