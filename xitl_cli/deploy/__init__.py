"""Installation of the agent on a board: `package` makes one file of it, `ssh` and `deploy` transfer it."""
