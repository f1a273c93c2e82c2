"""The node graph of a simulation, as described and as measured (graph.py), and its realism index (wdri.py)."""
