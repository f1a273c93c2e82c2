"""Links to agents: connections, inboxes, counts, clocks and loopbacks."""
