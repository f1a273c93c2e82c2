"""The failure of a plug-in's node."""

from __future__ import annotations

from xitl_cli.errors import UserError


class PluginNodeError(UserError):
    """A node of a plug-in raised an exception. It ends the run, whatever `clock.on_loss` is."""
