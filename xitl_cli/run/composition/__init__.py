"""The nodes of a run, as declarations: vessel.py and world.py list them, parts.py makes them."""
