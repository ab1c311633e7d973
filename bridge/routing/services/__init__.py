"""Services between one side and the hub; the three services of an action are such too."""
