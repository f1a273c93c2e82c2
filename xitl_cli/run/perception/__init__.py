"""The sensors of a companion: they look at the world, their clouds and pings go out in chunks."""
