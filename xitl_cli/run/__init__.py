"""One run of a profile: a plant, nodes, a loop.

session.py  from profile to summary: make the nodes, reach them, loop, close everything whatever happens
compose.py  every kind of node, made from the profile; the order of the list is the order of the calls
loop.py     wait for the instant, step the world, let every node sense, exchange and record
summary.py  summary.json, merged from what the nodes report; run_graph.py, view.py
core/       what all of it stands on: the node interface, reports, time, statistics, seeds, faults, the directory
world/      what is simulated: plant, scenery, waterway, encounters, scene
sensors/    what is measured: instruments, their messages, their faults
links/      agents: connection, inbox, accounts, timing, peers, loopbacks
nodes/      what takes part: autopilot, bridge, standby, companion, direct control, drivers, river, scores, recorders

An IMU sample goes world/plant.py -> sensors/sensing.py -> nodes/autopilot.py -> links/connection.py, and the motor
commands come back by links/inbox.py -> nodes/autopilot.py -> loop.py -> world/plant.py. A second vessel is another
VesselNodes (core/node.py) in the session's list, with a name for its topics and its part of the summary.
"""
