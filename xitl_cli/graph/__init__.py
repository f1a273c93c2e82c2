"""The node graph of a simulation (graph.py), its realism index (wdri.py) and the measured graph (measured.py)."""
