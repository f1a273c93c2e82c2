"""Links to agents: connections, what arrives on them, their counts and clocks, loopbacks."""
