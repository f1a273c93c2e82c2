"""What stands and drifts in the river, and what a ray or a hull meets of it."""
