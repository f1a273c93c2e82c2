"""The simulation: vessels, their surroundings and their sensors as numpy arrays with a leading vessel axis.

State in, state out. No clock, no sockets, no MAVLink.
"""
