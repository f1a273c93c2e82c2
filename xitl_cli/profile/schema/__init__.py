"""The schema of a profile: frozen dataclasses, one for each group of keys.

The keys of simulated things are with their models: sim_core/{vessel,environment,world,sensors}/spec.py.

Profile                        profile.py
├── name, description, technique
├── site, world                world.py, sim_core/world/spec.py
├── vehicle                    sim_core/vessel/spec.py
├── environment                sim_core/environment/spec.py
├── sensors                    sensors.py, sim_core/sensors/spec.py
├── mission, driver, autopilot, companion   agents.py
├── clock, recording, view, live   profile.py
├── ros                        ros.py
├── faults                     faults.py
├── plugins                    profile.py; the package of each plug-in has its keys
├── graph                      graph.py, derived_graph.py (the graph that follows from the other groups)
├── ais                        sim_core/world/spec.py
└── vessels                    fleet.py; each is read as a Profile: xitl_cli/profile/fleet.py
"""

from xitl_cli.profile.schema.profile import Profile, RunProfile

__all__ = ["Profile", "RunProfile"]
