"""The node graph of a simulation and its realism index (WDRI): graph.py, wdri.py; measured.py for the traffic of a
run.
"""
