"""The command `xitl map`: build the map of a recording again and compare it with the world."""
