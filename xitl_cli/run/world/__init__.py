"""The simulated world: vessel, surroundings, drifting bodies and collisions."""
