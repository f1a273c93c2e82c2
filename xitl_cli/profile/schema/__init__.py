"""The schema of a profile, one file per group of keys.

Profile
├── name, description, technique
├── site, world          place.py, debris.py
├── vehicle              vehicle.py
├── environment          environment.py
├── sensors              sensors.py, perception.py
├── mission, driver, autopilot   operation.py
├── companion            companion.py
├── clock, recording     session.py
├── faults               faults.py
└── graph                graph.py, derived_graph.py (what follows from the others)
"""

from xitl_cli.profile.schema.profile import Profile, RunProfile

__all__ = ["Profile", "RunProfile"]
