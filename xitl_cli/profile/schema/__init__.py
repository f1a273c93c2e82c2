"""The schema of a profile: frozen dataclasses, one for each group of keys.

What a simulated thing is in numbers stands with its model: sim_core/{vessel,environment,world,sensors}/spec.py. Here is
the rest: what a profile is put together from.

Profile                        profile.py
├── name, description, technique
├── site, world                world.py, sim_core/world/spec.py
├── vehicle                    sim_core/vessel/spec.py
├── environment                sim_core/environment/spec.py
├── sensors                    sensors.py, sim_core/sensors/spec.py
├── mission, driver, autopilot, companion   agents.py
├── clock, recording           profile.py
├── view                       view.py
├── ros                        ros.py
├── faults                     faults.py
├── plugins                    plugins.py; the keys of each are in the package of the plug-in
├── graph                      graph.py, derived_graph.py (what follows from the others)
├── ais                        sim_core/world/spec.py
└── vessels                    fleet.py, formation.py; each is read as a Profile: xitl_cli/profile/fleet.py
"""

from xitl_cli.profile.schema.profile import Profile, RunProfile

__all__ = ["Profile", "RunProfile"]
