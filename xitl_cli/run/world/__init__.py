"""What is simulated: vessel, surroundings, what drifts and what the hull meets."""
