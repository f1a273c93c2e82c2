"""The command `xitl map`: rebuild the map of a recording and compare it with the world."""
