"""Profiles: YAML files, composed, overridden and checked. Every problem is reported with its file and line."""

from xitl_cli.profile.files.entry import Problem, ProfileError
from xitl_cli.profile.load import LoadedProfile, load_profile, load_with_origins
from xitl_cli.profile.resolved import resolved_yaml
from xitl_cli.profile.schema import Profile, RunProfile

__all__ = [
    "LoadedProfile",
    "Problem",
    "Profile",
    "ProfileError",
    "RunProfile",
    "load_profile",
    "load_with_origins",
    "resolved_yaml",
]
