"""The node graph of a simulation, and how close it stands to a reference (WDRI)."""
