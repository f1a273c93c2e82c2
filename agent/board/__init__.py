"""Tools on the board in addition to the agent: installation, the service, and checks of the board."""
