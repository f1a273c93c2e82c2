"""Getting the agent onto a board: `package` makes one file of it, `ssh` and `deploy` bring it there."""
