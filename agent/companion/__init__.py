"""The companion computer's side of the agent."""
