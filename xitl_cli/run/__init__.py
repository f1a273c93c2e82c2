"""One run of a profile: a plant, nodes and a loop.

  session.py    from profile to summary: make the nodes, connect to them, run the loop, and always close everything
  composition/  the declarations of all nodes: needs, product, place in the step; and how they are resolved
  loop.py       wait for the instant, step the world, let every node sense, exchange and record
  summary.py    summary.json with the verdict, merged from the reports of the nodes; run_graph.py
  core/         the base: node interface, reports, scores against the truth, time, faults, the run directory
  world/        the simulated world: plant, scenery, waterway, encounters, scene
  sensors/      the sensors: instruments, their messages, their faults
  links/        agents: connection, inbox, accounts, peers, loopbacks, commands of an autopilot; launch of its firmware
  nodes/        every node: autopilot, bridge, companion, direct control, drivers, river, operator, display, recorders
  operator/     actions of a person: their definition, their streams and their replay

An IMU sample goes through world/plant.py, sensors/sensing.py, nodes/autopilot.py and links/connection.py. The motor
commands return through links/inbox.py, nodes/autopilot.py, loop.py and world/plant.py. Each further vessel has its own
VesselNodes (core/node.py) in the session's list, with a name for its topics and its part of the summary.
"""
